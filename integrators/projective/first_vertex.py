"""The first vertex of paths from a camera through media, and what becomes of its light if the camera alone moves.

Vertices stay where they are, in volume or area measure. So only a few factors of a path change: its place on the film,
the density of camera rays at the first vertex, how well this one scatters light towards the camera, and the
transmittance up to there. See `docs/theory/moving-geometry.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import (
    SHADOW_EPSILON,
    BSDFContext,
    BSDFFlags,
    DirectionSample3f,
    Ray3f,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.core.records.flags import PhaseFunctionContext
from djpt.core.records.interactions import GRAZING, MediumInteraction3f
from djpt.integrators.base import trace_path
from djpt.integrators.projective.film_geometry import way_ahead
from djpt.integrators.projective.reattach import relative
from djpt.integrators.volpath import VolumetricPath, VolumetricPathState, vertex_of
from djpt.jit.kernels import loop_traced_once, wide
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f
from djpt.media.flight import Flight

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["FirstVertex"]


RARE = 1e-30
"""The density of a direction whose light is left to light sampling."""


@dataclass
class Passage:
    """A segment in a medium, chosen among those that a ray has passed, in proportion to their lengths: loop state."""

    length: Float
    """The length of all segments so far."""
    begin: Float
    """Where it begins, from the ray's origin on."""
    end: Float
    before: Normal3f
    """The normal of the surface on which it begins; 0 if that is the ray's origin."""
    behind: Normal3f
    """The normal of the surface on which it ends; 0 if that is the vertex."""
    medium: UInt32

    def with_segment(
        self, begin: Float, end: Float, before: Normal3f, behind: Normal3f, medium: UInt32, chance: Float, active: Bool
    ) -> Passage:
        """The passage with one more segment, chosen by a uniform number, `chance`."""
        length = dr.select(active, end - begin, 0)
        total = self.length + length
        chosen = active & (chance * total < length)
        return dr.select(chosen, Passage(total, begin, end, before, behind, medium), replace(self, length=total))


@dataclass
class Way:
    """A camera ray on its way through null surfaces: loop state."""

    o: Point3f
    medium: UInt32 | None
    flown: Float
    """The length up to `o`."""
    begun: Float
    """The length up to where the segment began on which `o` lies."""
    left: Normal3f
    """The normal of the surface on which it began; 0 at the ray's origin."""
    flight: Flight
    """The last flight, which may begin at `o`."""
    passage: Passage
    state: Any
    sampler: Any
    active: Bool


@dataclass
class FirstVertex:
    """The first vertex of paths in a medium, or on a surface that isn't null; or of an environment."""

    o: Point3f
    """The origin of the camera ray."""
    d: Vector3f
    """Its direction."""
    p: Point3f
    """The place of the vertex; of no meaning in an environment."""
    n: Normal3f
    """The geometric normal; 0 where there is no surface."""
    far: Bool
    """True in an environment."""
    inside: Bool
    """True where light is scattered in a medium."""
    medium: UInt32 | None
    """The medium before the vertex; None in scenes without media."""
    si: SurfaceInteraction3f
    emitted: Color3f
    """Light that the vertex emits; all three are weighted with the transmittance over the density of the vertex."""
    reflected: Color3f
    """Light of an emitter that is scattered to the camera."""
    to_light: Vector3f
    """The direction from which it comes."""
    scattered: Color3f
    """All other light that is scattered to the camera."""
    onward: Vector3f
    passage: Passage
    """A segment before the vertex, for the derivative of transmittance."""

    @property
    def radiance(self) -> Color3f:
        """The light that arrives at the ray's origin."""
        return self.emitted + self.reflected + self.scattered

    @staticmethod
    def seen(
        integrator: VolumetricPath,
        scene: Scene,
        sampler: Any,
        ray: Ray3f,
        active: Bool | bool = True,
        clear: float = 0.0,
        indirect: bool = False,
    ) -> FirstVertex:
        """Follow paths that begin with given rays, each in its medium; light of emitters is left out if `indirect`.

        Where that medium scatters light within the distance `clear`, and before the first surface, is left out.
        """
        start = integrator.begin(scene, sampler)
        assert isinstance(start, VolumetricPathState)
        way = walked(integrator, scene, sampler, ray, start, active, clear)
        last = Ray3f(way.o, ray.d, maxt=ray.maxt - way.flown, medium=way.medium)
        sampler, state = way.sampler, way.state
        si = integrator.trace(scene, state, last)
        flight, passage = way.flight, way.passage
        return FirstVertex._of(integrator, scene, sampler, state, ray.o, last, si, flight, passage, active, indirect)

    @staticmethod
    def close_by(
        integrator: VolumetricPath, scene: Scene, sampler: Any, ray: Ray3f, start: Float, clear: float
    ) -> FirstVertex:
        """Follow paths whose first vertex is what `seen` leaves out; rays begin at the distance `start` of a centre.

        Distances from there, r, have densities in proportion to 1 / r: so fast do vertices move on the film.
        """
        state = integrator.begin(scene, sampler)
        assert isinstance(state, VolumetricPathState)
        si = integrator.trace(scene, state, ray)
        end = start + dr.minimum(dr.select(si.is_valid(), si.t, ray.maxt), clear)
        scale = dr.log(end / start)
        r = start * dr.exp(scale * sampler.next_1d())
        t = r - start
        return FirstVertex._scattering_at(integrator, scene, sampler, state, ray, si, t, r * scale)

    @staticmethod
    def at_distance(integrator: VolumetricPath, scene: Scene, sampler: Any, ray: Ray3f, t: Float) -> FirstVertex:
        """Follow paths whose first vertex is at the distance `t`, in the medium of the ray; per unit of length."""
        state = integrator.begin(scene, sampler)
        assert isinstance(state, VolumetricPathState)
        si = integrator.trace(scene, state, ray)
        return FirstVertex._scattering_at(integrator, scene, sampler, state, ray, si, t, Float(1))

    @staticmethod
    def _scattering_at(
        integrator: VolumetricPath,
        scene: Scene,
        sampler: Any,
        state: VolumetricPathState,
        ray: Ray3f,
        si: SurfaceInteraction3f,
        t: Float,
        weight: Float,
    ) -> FirstVertex:
        """The vertex in a medium at a distance `t` on a ray, with the inverse `weight` of its density."""
        assert ray.medium is not None
        sigma_s, _ = scene.media.coefficients(ray.medium, MediumInteraction3f.on(ray, t), Bool(True))
        value = sigma_s * scene.media.transmittance(ray, t, sampler, Bool(True)) * weight
        flight = Flight(t, Bool(True), value, Color3f(1), Color3f(0))
        passage, still = nothing_passed(scene, dr.width(ray, t)), Normal3f(0)
        passage = passage.with_segment(Float(0), t, still, still, ray.medium, Float(0), scene.media.fill(ray.medium))
        return FirstVertex._of(integrator, scene, sampler, state, ray.o, ray, si, flight, passage, True)

    @staticmethod
    def on_surface(
        integrator: VolumetricPath,
        scene: Scene,
        sampler: Any,
        ray: Ray3f,
        si: SurfaceInteraction3f,
        active: Bool,
        indirect: bool = False,
    ) -> FirstVertex:
        """Follow paths that begin at surface points `si`, seen along rays, with nothing between."""
        state = integrator.begin(scene, sampler)
        assert isinstance(state, VolumetricPathState)
        si = si.replaced(media=() if ray.medium is None else (ray.medium,))
        passage = nothing_passed(scene, dr.width(ray, si))
        nothing = Flight.none()
        return FirstVertex._of(integrator, scene, sampler, state, ray.o, ray, si, nothing, passage, active, indirect)

    @staticmethod
    def _of(
        integrator: VolumetricPath,
        scene: Scene,
        sampler: Any,
        state: VolumetricPathState,
        o: Point3f,
        last: Ray3f,
        si: SurfaceInteraction3f,
        flight: Flight,
        passage: Passage,
        active: Bool | bool,
        indirect: bool = False,
    ) -> FirstVertex:
        """The vertex at the end of a flight along the `last` part of a ray from `o`, and the rest of its path."""
        v = integrator.arrive(scene, sampler, state, last, si, flight)
        emitted, reflected, onward_state = v.emitted, Color3f(0), v.state
        if indirect:
            # As if light sampling had all of what the next ray meets.
            emitted, onward_state = Color3f(0), replace(v.state, bsdf_pdf=Float(RARE))
        else:
            reflected = integrator.transmittance(scene, sampler, v)
        (onward,), _ = trace_path(integrator, scene, sampler, v.ray, Bool(active) & v.active, state=onward_state)
        at = vertex_of(last, si, flight)
        far = ~at.is_valid()
        parts = (emitted, reflected, onward)
        emitted, reflected, onward = (Color3f(dr.select(Bool(active), part, 0)) for part in parts)
        return FirstVertex(
            o=Point3f(o),
            d=last.d,
            p=at.p,
            n=at.n,
            far=far,
            inside=flight.scattered,
            medium=last.medium,
            si=si,
            emitted=emitted,
            reflected=reflected,
            to_light=dr.normalize(v.shadow_ray.d),
            scattered=onward,
            onward=v.ray.d,
            passage=passage,
        )

    # ---- as the camera moves --------------------------------------------------------------

    def attached(self, scene: Scene, sensor: Any, chance: Float) -> tuple[Color3f, Point2f]:
        """The radiance and the place on the crop window, [0, 1)^2, attached to what places the camera.

        Args:
            scene: the scene.
            sensor: the camera, attached; of one with a lens, what is seen through a point of it.
            chance: uniform numbers.
        """
        ds, importance = sensor.sample_wi(self.place(sensor), Point2f(0))
        # A vertex stands for a volume, an area, or, in an environment, a solid angle, whose distance doesn't change.
        density = importance * dr.select(self.inside | self.far, 1, dr.abs(dr.dot(self.n, ds.d)))
        factor = Color3f(relative(density))
        if self.medium is not None:
            factor *= self._relative_transmittance(scene, ds.p, chance)
        return factor * self._scattered_towards(scene, ds), ds.uv

    def place(self, sensor: Any) -> Point3f:
        """The places of vertices; those of an environment go with the camera, attached, and keep their direction."""
        if not sensor.is_central:
            return self.p
        return dr.select(self.far, sensor.origin + way_ahead(sensor, self.d), self.p)

    def _scattered_towards(self, scene: Scene, ds: DirectionSample3f) -> Color3f:
        """The radiance of the vertex towards the camera."""
        si = self.si.replaced(wi=self.si.to_local(ds.d))
        on_surface = ~self.inside & self.si.is_valid()
        emitted = self.emitted * relative(self.si.emitter(scene).eval(si, on_surface))
        return emitted + sum(
            light * relative(self._scattering(scene, ds.d, si, d, on_surface))
            for light, d in ((self.reflected, self.to_light), (self.scattered, self.onward))
        )

    def _scattering(
        self, scene: Scene, towards: Vector3f, si: SurfaceInteraction3f, d: Vector3f, on_surface: Bool
    ) -> Color3f:
        """The phase function or the BSDF, for light from a direction `d`."""
        value = si.bsdf().eval(BSDFContext(), si, si.to_local(d), on_surface)
        if self.medium is None or not scene.media.scatter:
            return Color3f(value)
        mei = MediumInteraction3f.on(Ray3f(self.o, -towards), Float(0), self.p)
        phase = scene.media.phases(self.medium)
        in_medium, _ = phase.eval_pdf(PhaseFunctionContext(None), mei, d, self.inside)
        return Color3f(dr.select(self.inside, in_medium, value))

    def _relative_transmittance(self, scene: Scene, o: Point3f, chance: Float) -> Color3f:
        """1, with the derivative of the logarithm of the transmittance from `o`.

        tau is estimated at a uniform point of the chosen segment, whose ends move over the surfaces on which they lie.
        """
        chosen, still = self.passage, Ray3f(self.o, self.d)
        distance = dr.norm(self.p - o)
        d = dr.select(self.far, self.d, (self.p - o) / distance)

        def moved(at: Float, n: Normal3f, otherwise: Float) -> Float:
            across = dr.dot(d, n)
            on_surface = dr.abs(across) > GRAZING
            return Float(dr.select(on_surface, dr.dot(still(at) - o, n) / dr.select(on_surface, across, 1), otherwise))

        begin = moved(chosen.begin, chosen.before, chosen.begin)
        fixed_end = dr.squared_norm(chosen.behind) > 0
        end = moved(chosen.end, chosen.behind, dr.select(fixed_end, chosen.end, distance))
        segment = Ray3f(dr.fma(d, begin, o), d, medium=chosen.medium)
        first, last = Float(0), end - begin
        tracked = scene.media.are_tracked(chosen.medium)
        in_box = scene.media.in_box(segment, last)
        first, last = (dr.select(tracked, x, y) for x, y in zip(in_box, (first, last), strict=True))
        matter = chosen.length > 0
        mei = MediumInteraction3f.on(segment, dr.lerp(first, last, chance))
        _, sigma_t = scene.media.coefficients(chosen.medium, mei, matter)
        share = dr.select(matter, chosen.length / dr.detach(end - begin), 0)
        tau = sigma_t * ((last - first) * share)
        return dr.select(matter & dr.isfinite(tau), 1 + (dr.detach(tau) - tau), 1)


def nothing_passed(scene: Scene, lanes: int) -> Passage:
    """The passage of rays that have just begun."""
    zero, vacuum = Float(0), UInt32(scene.media.vacuum)
    begun: Passage = wide(Passage(zero, zero, zero, Normal3f(0), Normal3f(0), vacuum), lanes)
    return begun


def walked(
    integrator: VolumetricPath,
    scene: Scene,
    sampler: Any,
    ray: Ray3f,
    state: VolumetricPathState,
    active: Bool | bool,
    clear: float,
) -> Way:
    """Follow rays through null surfaces, up to where light is scattered, or to the last segment."""
    lanes = dr.width(ray, sampler)
    start = Way(
        o=ray.o,
        medium=ray.medium,
        flown=Float(0),
        begun=Float(0),
        left=Normal3f(0),
        flight=Flight(Float(0), Bool(False), Color3f(1), Color3f(1), Color3f(0)),
        passage=nothing_passed(scene, lanes),
        state=state,
        sampler=sampler,
        active=Bool(active),
    )
    if clear > 0 and ray.medium is not None:
        start = after(scene, integrator, start, ray, clear)

    def step(way: Way) -> tuple[Way]:
        here = Ray3f(way.o, ray.d, maxt=ray.maxt - way.flown, medium=way.medium)
        si = integrator.trace(scene, way.state, here, way.sampler)
        sampler = way.sampler
        flight = Flight.none()
        if here.medium is not None:
            flight = integrator.flight(scene, sampler, way.state, here, si)
        crosses = si.is_valid() & ~flight.scattered & has_flag(si.bsdf().flags(), BSDFFlags.Null)
        ends = way.flown + dr.select(flight.scattered, flight.t, si.t)
        passage = way.passage
        if way.medium is not None:
            in_medium = way.active & scene.media.fill(way.medium) & (flight.scattered | si.is_valid())
            behind, chance = dr.select(crosses, si.n, Normal3f(0)), sampler.next_1d()
            passage = passage.with_segment(way.begun, ends, way.left, behind, way.medium, chance, in_medium)
        on = si.spawn_ray(ray.d)
        flown = dr.dot(on.o - ray.o, ray.d)
        crossed = replace(
            way,
            o=on.o,
            medium=on.medium,
            flown=flown,
            begun=flown,
            left=si.n,
            state=replace(way.state, throughput=way.state.throughput_after(flight)),
        )
        moved = dr.select(crosses & way.active, crossed, way)
        return (replace(moved, flight=flight, passage=passage, sampler=sampler, active=way.active & crosses),)

    (end,) = loop_traced_once(wide(start, lanes), lambda way: way.active, step, "to the first vertex")
    return end


def after(scene: Scene, integrator: VolumetricPath, way: Way, ray: Ray3f, clear: float) -> Way:
    """The way after a distance in which no light is scattered, or just before the first surface."""
    assert ray.medium is not None
    si = integrator.trace(scene, way.state, ray)
    length = dr.minimum(dr.select(si.is_valid(), si.t * (1 - SHADOW_EPSILON), ray.maxt), clear)
    left = scene.media.transmittance(ray, length, way.sampler, way.active)
    return replace(way, o=ray(length), flown=length, state=replace(way.state, throughput=way.state.throughput * left))
