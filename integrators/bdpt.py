"""Bidirectional path tracing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import drjit as dr

from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import RenderError
from djpt.frame import Frame3f
from djpt.integrators.both_ends import End, Scattering, balance, evaluate, meeting, mis_weight, power, scatter
from djpt.integrators.splatting import Sink, SplattingIntegrator
from djpt.integrators.strategies import MAX_PYRAMID, Ledger, layer_names
from djpt.integrators.unidirectional import UNBOUNDED, first_roulette, roulette
from djpt.kernels import loop_traced_once, maximum, minimum, while_loop, wide
from djpt.records import (
    RAY_EPSILON,
    BSDFFlags,
    DirectionSample3f,
    EmitterFlags,
    Ray3f,
    Reference,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.records.record import Record
from djpt.samplers.base import SampleStream
from djpt.sensors.base import Sensor
from djpt.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f

if TYPE_CHECKING:
    from djpt.scene import Scene

__all__ = ["BidirectionalPath"]

JOINED = 32
"""Edges of the longest path that is joined from both ends; longer ones are left to the camera's side."""

LITTLE = 0.25
"""A share of the light that a camera path has found: rays of connections that bring less aren't worth their time."""


class LightVertex(Record):
    """A vertex of a light path, as local memory keeps it: the surface point, and what arrives there.

    What nobody reads costs nothing: LLVM leaves it out.
    """

    p: Point3f
    n: Normal3f
    sh_frame: Frame3f
    uv: Point2f
    dp_du: Vector3f
    dp_dv: Vector3f
    prim_uv: Point2f
    wi: Vector3f
    face: UInt32
    shape_index: UInt32
    flux: Color3f
    vcm: Float
    vc: Float
    depth: UInt32

    @staticmethod
    def at(si: SurfaceInteraction3f, end: End, flux: Color3f) -> LightVertex:
        """The vertex `si`, where the `end` of a light path has arrived with a flux."""
        kept = {name: getattr(si, name) for name in SURFACE}
        vertex: LightVertex = LightVertex.holding(**kept, flux=flux, vcm=end.vcm, vc=end.vc, depth=end.depth)
        return vertex

    def surface(self, scene: Scene) -> SurfaceInteraction3f:
        """The surface point."""
        kept = {name: getattr(self, name) for name in SURFACE}
        si: SurfaceInteraction3f = SurfaceInteraction3f.holding(**kept, media=(), home={scene: ()})
        return si


SURFACE = ("p", "n", "sh_frame", "uv", "dp_du", "dp_dv", "prim_uv", "wi", "face", "shape_index")
"""The fields of a surface point that BSDFs look at."""


@dataclass
class Lane:
    """Loop state of either walk."""

    end: End
    sampler: Any
    active: Bool
    vertices: Any
    """The vertices of the light path, in local memory."""
    count: UInt32
    """Their number."""


@dataclass
class CameraLane(Lane):
    """Loop state of the walk from the camera."""

    radiance: Color3f
    covered: Bool


AnyLane = TypeVar("AnyLane", bound=Lane)


class BidirectionalPath(SplattingIntegrator):
    """Joins a path from the camera and one from a light in all ways that there are.

    A light path y_0 .. y_(m-1) and a camera path x_0 .. x_(n-1) give, for each s <= m and t <= n, one sample of the
    light along paths of s + t - 1 edges: s = 0 is a light that is met, s = 1 a light sample, t = 1 a light path's
    vertex that the camera sees. Each counts with its weight against all others that could have made the same path:
    see `djpt.integrators.both_ends`.

    Strong where light comes from a lamp in a fixture or through glass; elsewhere a sample costs several times as
    much as one of `path`, and gains little. Scattering media aren't followed. Sensors that light can't be traced to,
    such as meters, are left out as ends: t = 1 then gives nothing.

    Parameters: `max_depth` (edges of the longest path, -1 = unbounded, default -1), `rr_depth` (Russian roulette
    starts there, on either side, default 5), `hide_emitters`, `emitter_choice` (`uniform`, default, or `power`),
    `heuristic` (`power`, default, or `balance`), `strategies` (default false): further images, of each strategy by
    itself, weighted (``s2t3.R`` ..) and as if there were no other (``s2t3.alone.R`` ..), for paths of two and more
    edges; needs a `max_depth` from 2 to 8. Paths of more than 32 edges are found from the camera only.

    E. Lafortune and Y. Willems, "Bi-directional Path Tracing", 1993; E. Veach and L. Guibas, "Bidirectional Estimators
    for Light Transport", 1994; weights are those of I. Georgiev, "Implementing Vertex Connection and Merging", 2012.
    """

    starts_at_lights = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", -1, low=-1)
        self.rr_depth = first_roulette(props, self.max_depth)
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=("uniform", "power"))
        self.h = {"power": power, "balance": balance}[props.string("heuristic", "power", choices=("power", "balance"))]
        self.strategies = props.boolean("strategies", False)
        if self.strategies and not 2 <= self.max_depth <= MAX_PYRAMID:
            raise props.error("strategies", f"needs a 'max_depth' from 2 to {MAX_PYRAMID}, found {self.max_depth}")
        self.longest = UNBOUNDED if self.max_depth < 0 else self.max_depth
        self.joined = min(self.longest, JOINED)

    def layer_names(self) -> Sequence[str]:
        return layer_names(self.max_depth) if self.strategies else ()

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        scattering = [medium.id() for medium in scene.every_medium.plugins if medium.phase is not None]
        if scattering:
            raise RenderError(
                f"'bdpt' doesn't follow light through scattering media, found {', '.join(scattering)}; "
                "possible: the integrator 'volpath'"
            )
        super().check_scene(scene, sensor)

    def prepare_scene(self, scene: Scene) -> None:
        super().prepare_scene(scene)
        scene.brightness  # noqa: B018

    def splat_sample(
        self, scene: Scene, camera: Sensor, sampler: SampleStream, ray: Ray3f, position: Point2f, sink: Sink
    ) -> tuple[Color3f, Bool, list[Float]]:
        ledger, lanes = Ledger(sink, position, self.strategies), dr.width(ray, sampler)
        end, power = self.at_light(scene, sampler)
        light = Lane(
            end=wide(end, lanes),
            sampler=sampler,
            active=dr.full(Bool, self.joined > 1, lanes),
            vertices=dr.alloc_local(LightVertex, max(1, self.joined - 1)),
            count=dr.zeros(UInt32, lanes),
        )

        def from_light(lane: Lane) -> tuple[Lane]:
            return (self.light_vertex(scene, camera, lane, power, ledger),)

        (light,) = loop_traced_once(light, lambda lane: lane.active, from_light, "light path")
        camera_path = CameraLane(
            end=wide(self.at_camera(scene, camera, ray, ledger.inside), lanes),
            sampler=light.sampler,
            active=dr.full(Bool, self.max_depth != 0, lanes),
            vertices=light.vertices,
            count=light.count,
            radiance=dr.zeros(Color3f, lanes),
            covered=dr.full(Bool, False, lanes),
        )

        def from_camera(lane: CameraLane) -> tuple[CameraLane]:
            return (self.camera_vertex(scene, lane, ray.maxt, ledger),)

        (camera_path,) = loop_traced_once(camera_path, lambda lane: lane.active, from_camera, "camera path")
        sky = scene.environment() is not None and not self.hide_emitters and self.max_depth != 0
        return camera_path.radiance, camera_path.covered | sky, []

    # ---- from the light ----------------------------------------------------------------

    def at_light(self, scene: Scene, sampler: SampleStream) -> tuple[End, Float]:
        """A path that leaves an emitter, with throughputs up to 1, and the power that they are shares of."""
        index, inverse, _ = scene.emitter_choice.choose(Point3f(0), None, sampler.next_1d())
        emitter = scene.emitter_ptr(index)
        es = emitter.sample_emission(sampler.next_2d(), sampler.next_2d())
        # Off the surface, along the ray, whichever side that is.
        a = dr.abs(es.ray.o)
        largest = maximum(maximum(a.x, a.y), a.z)
        o = dr.fma(es.ray.d, dr.fma(largest, RAY_EPSILON, RAY_EPSILON), es.ray.o)
        # The density of light sampling over that of emission; the choice of the emitter is part of both.
        vcm = self.h(dr.rcp(dr.select(es.finite, es.pdf_direction, es.pdf_position)))
        if any(is_beam(e.flags()) for e in scene.emitters()):
            vcm = dr.select(is_beam(emitter.flags()), 0, vcm)  # no light sample finds it
        power = dr.max(es.weight) * inverse
        end = End(
            ray=Ray3f(o, es.ray.d, medium=scene.medium_at(o)),
            throughput=es.weight * dr.select(power > 0, inverse * dr.rcp(power), 0),
            vcm=vcm,
            vc=dr.select(es.delta, 0, self.h(es.cos * inverse * dr.rcp(es.pdf_position * es.pdf_direction))),
            before=dr.select(es.finite, Float(0), dr.inf),
            eta=Float(1) if scene.refracts else None,
            depth=UInt32(1),
        )
        return end, power

    def light_vertex(self, scene: Scene, camera: Sensor, lane: Lane, power: Float, ledger: Ledger) -> Lane:
        """Keep the next vertex of a light path, and show it to the camera."""
        si = scene.surface_interaction(lane.end.ray, scene.closest_hit(lane.end.ray), full=scene.needs_uv)
        end, sampler = self.joinable(lane.end.arrived(scene, si, self.h)), lane.sampler
        on = lane.active & si.is_valid()
        joins = on & has_flag(si.bsdf().flags(), BSDFFlags.Smooth)
        flux = end.throughput * power
        lane.vertices.write(LightVertex.at(si, end, flux), lane.count, joins)

        to_camera = si.wi
        if camera.can_be_reached:
            ds, importance = camera.look_from(si.p, sampler.next_2d() if camera.uses_aperture else Point2f(0.5))
            to_camera = si.to_local(ds.d)
        s = scatter(si, False, to_camera, sampler, on)
        if camera.can_be_reached:
            value = flux * s.value * importance
            if self.hide_emitters:
                value = dr.select(si.emitter().is_valid(), 0, value)
            value = dr.select(joins, value, 0)
            value = scene.light_between(si.spawn_ray_to(ds.p), value, through_lights=self.hide_emitters)
            weight = mis_weight(meeting(end.vcm, end.vc, importance * dr.abs(dr.dot(si.n, ds.d)), s.back, self.h))
            ledger.show(ds.uv, value, weight, end.depth + 1)

        on &= end.depth + 1 < self.joined
        lane.count = dr.select(joins, lane.count + 1, lane.count)
        return self.onwards(lane, end, si, s, end.depth > self.rr_depth, on)

    # ---- from the camera ---------------------------------------------------------------

    def at_camera(self, scene: Scene, camera: Sensor, ray: Ray3f, inside: Bool) -> End:
        """A path that begins with a camera ray; `inside`: whether a light path can be shown there."""
        vcm, before = Float(0), Float(0)
        if camera.can_be_reached:
            pdf, before = camera.pdf_ray(ray.d)
            vcm = dr.select(inside, self.h(dr.rcp(pdf)), 0)
        eta = Float(1) if scene.refracts else None
        return End(ray, Color3f(1), vcm, Float(0), before, eta, UInt32(1))

    def camera_vertex(self, scene: Scene, lane: CameraLane, maxt: Float, ledger: Ledger) -> CameraLane:
        """Add the light that the next vertex of a camera path sends back, by all strategies."""
        first = lane.end.depth == 1
        ray = lane.end.ray
        ray = Ray3f(ray.o, ray.d, maxt=dr.select(first, maxt, dr.inf), medium=ray.medium)
        hit = scene.closest_hit(ray, through_lights=first if self.hide_emitters else None)
        si = scene.surface_interaction(ray, hit, full=scene.needs_uv)
        end, sampler, t = lane.end.arrived(scene, si, self.h), lane.sampler, lane.end.depth + 1
        radiance = lane.radiance + self.met(scene, end, si, lane.covered, ledger)
        on = lane.active & si.is_valid() & (end.depth < self.longest)
        joins = on & has_flag(si.bsdf().flags(), BSDFFlags.Smooth)
        radiance += self.merged(end, si, joins)
        end = self.joinable(end)

        # ------------------- Light sampling -------------------
        light = scene.light_sampling.sample(Reference(si.p, si.n), sampler.next_2d(), joins)
        ds, to_light = light.ds, si.to_local(light.ds.d)
        s = scatter(si, True, to_light, sampler, on)
        value = dr.select(joins, end.throughput * s.value * light.weight, 0)
        value = scene.light_through(scene.shadow_ray(si, ds), value)
        weight = self.light_sample_weight(scene, end, si, ds, s)
        radiance += ledger.weighed(value, weight, UInt32(1), t)

        # --------------------- Connections --------------------
        def connect(i: UInt32, radiance: Color3f, sampler: Any, vertices: Any) -> tuple[UInt32, Color3f, Any, Any]:
            v = vertices.read(i)
            ray, value, weight = self.connection(end, si, v, v.surface(scene))
            value = self.through(scene, sampler, ray, value, weight, radiance)
            return i + 1, radiance + ledger.weighed(value, weight, v.depth + 1, t), sampler, vertices

        count = dr.select(joins, lane.count, 0)
        _, radiance, lane.sampler, lane.vertices = while_loop(
            (dr.zeros(UInt32, dr.width(count)), radiance, sampler, lane.vertices),
            lambda i, radiance, sampler, vertices: i < count,
            connect,
            label="connections",
        )
        lane.radiance = radiance
        passes = si.is_valid() & has_flag(s.sample.sampled_type, BSDFFlags.Null)
        lane.covered |= si.is_valid() & ~passes
        return self.onwards(lane, end, si, s, end.depth >= self.rr_depth, on)

    def met(self, scene: Scene, end: End, si: SurfaceInteraction3f, covered: Bool, ledger: Ledger) -> Color3f:
        """The light of the surface, or of the sky, that a camera path has met: s = 0."""
        emitter = si.emitter()
        radiance = end.throughput * emitter.eval(si)
        if self.hide_emitters:
            radiance = dr.select(covered | si.is_valid(), radiance, 0)
        chosen = scene.emitter_choice.probability(Point3f(0), None, emitter.index)
        position, direction = emitter.pdf_emission(-end.ray.d, si.sh_frame.n, si.uv)
        # Light from infinity is sampled by direction, and its rays by position then.
        last, before = (dr.select(si.is_valid(), a, b) for a, b in ((position, direction), (direction, position)))
        others = meeting(end.vcm, self.shared(end.vc, end.depth), chosen * last, before, self.h)
        weight = dr.select(end.depth == 1, 1, mis_weight(others))
        return ledger.weighed(radiance, weight, UInt32(0), end.depth + 1)

    def light_sample_weight(
        self, scene: Scene, end: End, si: SurfaceInteraction3f, ds: DirectionSample3f, s: Scattering
    ) -> Float:
        """The weight of a light sample: s = 1."""
        chosen = scene.emitter_choice.probability(Point3f(0), None, ds.emitter_index)
        position, direction = scene.emitter_ptr(ds.emitter_index).pdf_emission(-ds.d, ds.n, ds.uv)
        finite = ds.dist < dr.inf
        falloff = dr.select(finite, dr.rcp(dr.square(ds.dist)), 1)
        met = dr.select(finite, dr.abs(dr.dot(ds.n, ds.d)) * falloff * dr.rcp(position), dr.rcp(direction))
        by_bsdf = dr.select(ds.delta, 0, self.h(s.pdf * met * dr.rcp(chosen)))
        here = dr.select(finite, direction * falloff, position) * dr.abs(dr.dot(si.n, ds.d))
        by_light = meeting(end.vcm, end.vc, here, s.back, self.h)
        return mis_weight(by_bsdf + self.shared(by_light, end.depth + 1))

    def connection(
        self, end: End, si: SurfaceInteraction3f, v: LightVertex, lit: SurfaceInteraction3f
    ) -> tuple[Ray3f, Color3f, Float]:
        """The ray from `si` to the vertex `v` of the light path, at `lit`; what it sends back, and the weight."""
        to_light = v.p - si.p
        falloff = dr.rcp(dr.squared_norm(to_light))
        d = to_light * dr.sqrt(falloff)
        value, pdf, pdf_back = evaluate(si, True, si.to_local(d))
        sent, sent_pdf, sent_back = evaluate(lit, False, lit.to_local(-d))
        value = end.throughput * value * v.flux * sent * falloff
        at_light = pdf * dr.abs(dr.dot(lit.n, d)) * falloff
        at_camera = sent_pdf * dr.abs(dr.dot(si.n, d)) * falloff
        by_light = meeting(v.vcm, v.vc, at_light, sent_back, self.h)
        by_camera = meeting(end.vcm, end.vc, at_camera, pdf_back, self.h)
        fits = end.depth + v.depth < self.joined
        return si.spawn_ray_to(lit.offset_p(-d)), dr.select(fits, value, 0), mis_weight(by_light + by_camera)

    def through(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, value: Color3f, weight: Float, radiance: Color3f
    ) -> Color3f:
        """The part of the light `value` of a connection that arrives.

        Where rays search a tree, light that adds little to the `radiance` so far is followed by chance.
        """
        if scene.geometry.triangles is None or self.strategies:
            return scene.light_between(ray, value)
        chance = minimum(dr.max(value) * weight * dr.rcp(LITTLE * dr.max(radiance)), 1)
        survives = sampler.next_1d() < chance
        return scene.light_between(ray, dr.select(survives, value * dr.rcp(chance), 0))

    def merged(self, end: End, si: SurfaceInteraction3f, joins: Bool) -> Color3f:
        """The light that is found at a vertex of a camera path, where it `joins`, in other ways: none."""
        return Color3f(0)

    # ---- either way --------------------------------------------------------------------

    def joinable(self, end: End) -> End:
        """The end at a vertex that can be joined, with what further ways to join it add to `End.vcm`: nothing."""
        return end

    def shared(self, others: Float, edges: UInt32) -> Float:
        """The part of a weight that comes of further strategies, which longer paths don't have."""
        return others if self.joined == self.longest else dr.select(edges <= self.joined, others, 0)

    def onwards(
        self,
        lane: AnyLane,
        end: End,
        si: SurfaceInteraction3f,
        s: Scattering,
        roulette_begins: Bool,
        active: Bool,
    ) -> AnyLane:
        """A lane after its vertex `si`: the sampled continuation, or the end by Russian roulette."""
        eta = None if end.eta is None else end.eta * s.sample.eta
        throughput, survives = roulette(lane.sampler, end.throughput * s.weight, eta, roulette_begins)
        lane.end, lane.active = end.scattered(si, s, throughput, self.h), active & survives
        return lane


def is_beam(flags: Any) -> Any:
    """Whether light leaves a surface in one direction only: flags are `EmitterFlags`."""
    return has_flag(flags, EmitterFlags.Surface) & has_flag(flags, EmitterFlags.DeltaDirection)


register_integrator("bdpt", BidirectionalPath)
