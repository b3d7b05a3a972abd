"""The transmittance of shadow rays through null surfaces and media."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import SHADOW_EPSILON, BSDFFlags, PreliminaryIntersection3f, Ray3f, has_flag
from djpt.core.records.interactions import MediumInteraction3f
from djpt.geometry.aggregate import MeasuredMedia, NullSurfaces
from djpt.jit.kernels import wide
from djpt.jit.types import Bool, Color3f, Float, Point3f, UInt32, Vector3f
from djpt.media.differentials import own_stream
from djpt.media.flight import FAR
from djpt.samplers.base import SampleStream, go_on_with
from djpt.samplers.independent import IndependentStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["Aim", "null_surfaces", "null_transmittance", "transmittance", "way_through"]


@dataclass
class PassedMedia:
    """The media that a shadow ray has passed so far, as derivatives need them: loop state."""

    lengths: list[Float]
    """The length so far through each medium."""
    tracked: Float
    """The length so far within the boxes of tracked media."""
    o: Point3f
    """The origin of a uniform point of that length."""
    at: Float
    """The distance of that point from there."""
    medium: UInt32
    """The medium at that point."""
    stream: IndependentStream
    """The random numbers by which the point is chosen."""


@dataclass
class Shadow:
    """A shadow ray on its way: loop state."""

    o: Point3f
    medium: UInt32 | None
    t: Float
    """The distance of the next surface; infinite if there is none."""
    face: UInt32
    near: Any
    left: Color3f
    """The transmittance so far."""
    passed: PassedMedia | None
    """The media passed so far; None unless there are derivatives."""
    sampler: Any
    active: Bool


def transmittance(
    scene: Scene,
    sampler: SampleStream,
    ray: Ray3f,
    weight: Color3f,
    lit: Bool | None = None,
    *,
    to_emitter: bool = True,
    through_lights: bool = False,
) -> Color3f:
    """`Scene.transmittance`; among media that scatter, an estimate that looks through null surfaces.

    The estimate leaves out no shape, and shapes that emit always hide: `through_lights` has no effect on it.
    """
    if scene.media.scatter:
        return null_transmittance(scene, sampler, ray, weight, lit)
    return scene.transmittance(ray, weight, lit, to_emitter=to_emitter, through_lights=through_lights)


def null_transmittance(
    scene: Scene, sampler: SampleStream, ray: Ray3f, weight: Color3f, lit: Bool | None = None
) -> Color3f:
    """An estimate of the transmittance of a shadow ray through null surfaces and media, times `weight`.

    It is the product of V, which is 0 behind a surface that isn't null, of the transmittance of each null surface,
    and of exp(-tau) of each medium between them, which ratio tracking estimates where it has no closed form.
    Unlike `Scene.transmittance` it leaves out no shape: a point in a medium may lie behind a wall that stands around
    everything else. It has derivatives with respect to the media and `weight`; those with respect to null surfaces are
    left out. Where `lit`, the ray is followed although `weight` is black.
    """
    shines = dr.max(weight) > 0
    lit = shines if lit is None else shines | lit
    if not scene.bsdfs.have_null:
        # What stands in the way needs no light in the medium.
        aimed_ray = ray if ray.medium is None else aimed(ray, ray.o, ray.medium)
        free = ~scene.geometry.any_hit(aimed_ray, lit)
        return dr.select(free, weight * left_over(scene, sampler, aimed_ray, lit & free), 0)
    # No loop can be differentiated here; the transmittance is computed again behind it.
    with dr.suspend_grad():
        # Leaves that are made in a loop can't be used behind it.
        plain, attached = scene.replace(lookup=scene.lookup.plain()), scene.media.are_attached()
        media = MeasuredMedia(scene.geometry, are_null(scene), scene.media.plugins)
        passed: PassedMedia | None
        if media.are_measured:
            left, passed = measured(plain, media, sampler, dr.detach(ray), dr.detach(lit))
        else:
            end = ShadowWalk(plain, dr.detach(ray)).end(sampler, dr.detach(lit), measured=attached)
            go_on_with(sampler, end.sampler)
            left, passed = end.left, end.passed
        left = dr.select(lit, left, 0)
    if attached and passed is not None:
        left = reattached(scene, sampler, ray, left, passed)
    return weight * left


def way_through(scene: Scene, sampler: SampleStream, ray: Ray3f, active: Bool) -> tuple[Color3f, UInt32 | None]:
    """An estimate of the transmittance of a shadow ray, and the medium at its end; where not `active`, no light."""
    if scene.bsdfs.have_null and scene.media:
        end = ShadowWalk(scene, ray).end(sampler, active, measured=False)
        go_on_with(sampler, end.sampler)
        return dr.select(active, end.left, 0), end.medium
    left = transmittance(scene, sampler, ray, dr.select(active, Color3f(1), 0))
    return left, ray.medium


def measured(
    scene: Scene, media: MeasuredMedia, sampler: SampleStream, ray: Ray3f, lit: Bool
) -> tuple[Color3f, PassedMedia]:
    """The transmittance of a shadow ray by one search, and what it has passed."""
    blocked, lengths = media.passed(aimed(ray, ray.o, ray.medium), lit)
    left = dr.select(blocked, Color3f(0), 1)
    for number, length in enumerate(lengths):
        segment = aimed(ray, ray.o, UInt32(number))
        left = left * left_over(scene, sampler, segment.replaced(maxt=length), lit)
    return left, replace(begun(scene, ray), lengths=lengths)


class ShadowWalk:
    """The walk of a shadow ray from one null surface to the next.

    If they can be told apart from all others, whether anything opaque stands in the way is known before.
    """

    def __init__(self, scene: Scene, ray: Ray3f) -> None:
        self._scene, self._ray = scene, ray
        self._surfaces = null_surfaces(scene)

    def end(self, sampler: SampleStream, lit: Bool, measured: bool) -> Shadow:
        """The end of the ray, whose `left` is its transmittance; if `measured`, with what derivatives need.

        Where not `lit`, the result means nothing.
        """
        ray, lanes = self._ray, dr.width(self._ray, lit, sampler)
        way = aimed(ray, ray.o, ray.medium)
        free = ~self._surfaces.blocked(way, lit) if self._surfaces.are_apart else Bool(True)
        t, face, near, medium = self._next(way)
        start = Shadow(
            o=ray.o,
            medium=medium,
            t=t,
            face=face,
            near=near,
            left=dr.select(free, Color3f(1), 0),
            passed=begun(self._scene, ray) if measured else None,
            sampler=sampler,
            active=lit & free,
        )
        # Most shadow rays end within their medium: the loop is for the others.
        first = wide(self._pass_medium(start), lanes)
        (end,) = dr.while_loop((first,), lambda shadow: shadow.active, self._go_on, label="shadow")
        return end

    def _next(self, ray: Ray3f) -> tuple[Float, UInt32, Any, UInt32 | None]:
        """The distance of the next surface, its face, what else is known of the hit, and the medium up to there."""
        hit = self._surfaces.closest(ray) if self._surfaces.are_apart else self._scene.closest_hit(ray)
        return hit.t, hit.face, hit.near, hit.media[0] if hit.media else ray.medium

    def _go_on(self, shadow: Shadow) -> tuple[Shadow]:
        """Go through a surface, and on to the next one."""
        return (self._pass_medium(self._pass_surface(shadow)),)

    def _pass_medium(self, shadow: Shadow) -> Shadow:
        """Go on to the next surface, where `active`; afterwards true where it is to be passed."""
        scene, segment, active = self._scene, aimed(self._ray, shadow.o, shadow.medium), shadow.active
        hit, stopped = shadow.t < dr.inf, Bool(False)
        segment.maxt = dr.select(hit, shadow.t, segment.maxt)
        if not self._surfaces.are_apart:
            stopped = hit & ~has_flag(scene.bsdfs.at(shadow.face).flags(), BSDFFlags.Null)
        sampler = shadow.sampler
        left = shadow.left * left_over(scene, sampler, segment, active & ~stopped)
        left = dr.select(active, dr.select(stopped, 0, left), shadow.left)
        passed = shadow.passed
        if passed is not None:
            passed = longer(scene, passed, segment, active & ~stopped)
        goes_on = active & hit & (dr.max(left) > 0)
        return replace(shadow, left=left, passed=passed, sampler=sampler, active=goes_on)

    def _pass_surface(self, shadow: Shadow) -> Shadow:
        """Go through a surface, and find the next one."""
        scene, ray = self._scene, self._ray
        segment = aimed(ray, shadow.o, shadow.medium)
        hit = PreliminaryIntersection3f.found(shadow.t, shadow.face, scene.geometry.shape_of(shadow.face), shadow.near)
        si = scene.surface_interaction(segment, hit, scene.surface_detail)
        on = si.spawn_ray(segment.d)
        # Where the light lies on the surface, the ray has been moved past it.
        ahead = (ray.maxt == dr.inf) | (dr.dot(ray.o + ray.d - on.o, segment.d) > 0)
        t, face, near, medium = self._next(aimed(ray, on.o, on.medium))
        return replace(
            shadow,
            o=on.o,
            medium=medium,
            t=t,
            face=face,
            near=near,
            left=shadow.left * si.bsdf().eval_null_transmission(si),
            active=shadow.active & ahead,
        )


def begun(scene: Scene, ray: Ray3f) -> PassedMedia:
    """The state at the origin of a shadow ray, which has passed nothing."""
    lengths = [Float(0) for _ in scene.media.plugins]
    return PassedMedia(lengths, Float(0), Point3f(0), Float(0), UInt32(scene.media.vacuum), own_stream(ray, ray.maxt))


def longer(scene: Scene, passed: PassedMedia, segment: Ray3f, active: Bool) -> PassedMedia:
    """`passed` with one more segment: its uniform point moves there in proportion to the length."""
    assert segment.medium is not None
    filling = scene.media.filling(segment.medium)
    lengths = [
        total + dr.select(active & (filling == number), segment.maxt, 0) for number, total in enumerate(passed.lengths)
    ]
    start, end = scene.media.in_box(segment, segment.maxt)
    length = dr.select(active & (end < FAR), end - start, 0)
    place = passed.stream.next_1d() * (passed.tracked + length)
    here = (place < length) & (length > 0)
    return PassedMedia(
        lengths=lengths,
        tracked=passed.tracked + length,
        o=dr.select(here, segment.o, passed.o),
        at=dr.select(here, start + place, passed.at),
        medium=dr.select(here, segment.medium, passed.medium),
        stream=passed.stream,
    )


def reattached(scene: Scene, sampler: SampleStream, ray: Ray3f, left: Color3f, passed: PassedMedia) -> Color3f:
    """The transmittance `left`, with its derivatives by what the way through each medium leaves."""
    sigma_t = passed.tracked * scene.media.extinction_at(
        passed.medium,
        MediumInteraction3f.on(aimed(ray, passed.o, passed.medium), passed.at),
        passed.stream.next_1d(),
        passed.tracked > 0,
    )
    attached = left * (1 + (dr.detach(sigma_t) - sigma_t))
    for number, length in enumerate(passed.lengths):
        if scene.media.plugins[number].is_tracked:
            continue
        segment = aimed(ray, ray.o, UInt32(number))
        segment.maxt = length
        of_medium = left_over(scene, sampler, segment, length > 0)  # a closed form, which draws no numbers
        fixed = dr.detach(of_medium)
        attached = attached * dr.select(fixed > 0, of_medium * dr.rcp(fixed), 1)
    return dr.replace_grad(left, attached)  # type: ignore[func-returns-value, return-value]


def null_surfaces(scene: Scene) -> NullSurfaces:
    """Queries of a scene that tell its null surfaces from all others."""
    return NullSurfaces(scene.geometry, are_null(scene))


def are_null(scene: Scene) -> list[bool]:
    """Whether light may pass straight through, for each shape of a scene."""
    null = [has_flag(bsdf.flags(), BSDFFlags.Null) for bsdf in scene.bsdfs.plugins]
    return [null[number] for number in scene.bsdfs.of_shape]


@dataclass
class Aim:
    """The target of a shadow ray."""

    place: Point3f
    """The light's place, or the direction to it."""
    finite: Bool
    """True if it is a place."""

    @staticmethod
    def of(ray: Ray3f) -> Aim:
        """The target of a shadow ray from light sampling."""
        finite = ray.maxt < dr.inf
        return Aim(Point3f(dr.select(finite, ray.o + ray.d, ray.d)), finite)

    def ray_from(self, o: Point3f, medium: UInt32 | None) -> Ray3f:
        """The way to the light from a point `o`, with a unit direction: see `aimed`."""
        return toward(o, Vector3f(self.place - o), self.finite, Vector3f(self.place), medium)

    def lies_ahead(self, ray: Ray3f, d: Vector3f) -> Bool:
        """True unless the light lies on the surface that `ray` has just left, in the direction `d`."""
        return ~self.finite | (dr.dot(self.place - ray.o, d) > 0)


def aimed(ray: Ray3f, o: Point3f, medium: UInt32 | None) -> Ray3f:
    """The rest of a shadow ray from a point `o` on, with a unit direction.

    It is aimed again at the light: `o` was moved off a surface, and at a grazing angle the former direction would end
    behind the light.
    """
    return toward(o, ray.o + ray.d - o, ray.maxt < dr.inf, ray.d, medium)


def toward(o: Point3f, to_light: Vector3f, finite: Bool, d: Vector3f, medium: UInt32 | None) -> Ray3f:
    """The ray from `o` to a light: over the vector `to_light` if that is `finite`, else in the direction `d`."""
    squared = dr.squared_norm(to_light)
    inverse = dr.rsqrt(squared)
    maxt = dr.select(finite, squared * inverse * (1 - SHADOW_EPSILON), dr.inf)
    return Ray3f(o, dr.select(finite, to_light * inverse, d), maxt=maxt, medium=medium)


def left_over(scene: Scene, sampler: SampleStream, ray: Ray3f, active: Bool) -> Color3f:
    """The fraction of light that a medium leaves on a ray, up to its end."""
    return scene.media.transmittance(ray, ray.maxt, sampler, active)
