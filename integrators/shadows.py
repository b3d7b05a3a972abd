"""Shadow rays through null surfaces and media."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.kernels import wide
from djpt.media.differentials import own_stream
from djpt.media.flight import FAR
from djpt.records import SHADOW_EPSILON, BSDFFlags, Ray3f, has_flag
from djpt.records.media import MediumInteraction3f
from djpt.samplers.base import SampleStream, go_on_with
from djpt.samplers.independent import IndependentStream
from djpt.types import Bool, Color3f, Float, Point3f, UInt32

if TYPE_CHECKING:
    from djpt.scene import Scene

__all__ = ["light_through_null"]


@dataclass
class Way:
    """The way of a shadow ray through media, as far as derivatives need it: loop state."""

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
    """What takes the point."""


@dataclass
class Shadow:
    """A shadow ray on its way: loop state."""

    o: Point3f
    medium: UInt32 | None
    light: Color3f
    way: Way | None
    """What was passed so far; None unless there are derivatives."""
    sampler: Any
    active: Bool


def light_through_null(scene: Scene, sampler: SampleStream, ray: Ray3f, light: Color3f) -> Color3f:
    """The part of `light` that arrives along a shadow ray, through null surfaces and whatever media lie between.

    Unlike `Scene.light_through` it leaves out no shape: a point in a medium may lie behind a wall that stands around
    everything else. It has derivatives by the media and by `light`; those of null surfaces are left out.
    """
    lit = dr.max(light) > 0
    if not scene.has_null:
        # What stands in the way needs no light in the medium.
        free = ~scene.geometry.any_hit(ray, lit)
        return dr.select(free, light * left_over(scene, sampler, aimed(ray, ray.o, ray.medium), lit & free), 0)
    differentiable = any(
        scene.lookup.attaches(leaf) for ensemble in scene.media.ensembles for leaf in ensemble.leaves()
    )
    # No loop can be differentiated here; the transmittance is computed again behind it.
    with dr.suspend_grad():
        # Leaves that are made in a loop can't be used behind it.
        plain = scene.with_lookup(scene.lookup.plain())
        end = walked(plain, sampler, dr.detach(ray), Color3f(1), dr.detach(lit), differentiable)
    go_on_with(sampler, end.sampler)
    arrives = dr.select(lit, end.light, 0)
    if end.way is not None:
        arrives = reattached(scene, sampler, ray, arrives, end.way)
    return light * arrives


def walked(scene: Scene, sampler: SampleStream, ray: Ray3f, light: Color3f, lit: Bool, measured: bool) -> Shadow:
    """The end of a shadow ray that starts with `light`; with the lengths in each medium if `measured`."""
    lanes = dr.width(ray, lit, sampler)
    start = Shadow(
        o=wide(ray.o, lanes),
        medium=wide(ray.medium, lanes),
        light=wide(light, lanes),
        way=wide(begun(scene, ray), lanes) if measured else None,
        sampler=sampler,
        active=lit & dr.full(Bool, True, lanes),
    )

    def step(shadow: Shadow) -> tuple[Shadow]:
        segment = aimed(ray, shadow.o, shadow.medium)
        si = scene.surface_interaction(segment, scene.closest_hit(segment), full=scene.needs_uv)
        hit = si.is_valid()
        bsdf = si.bsdf()
        opaque = hit & ~has_flag(bsdf.flags(), BSDFFlags.Null)
        through = dr.select(hit, bsdf.eval_null_transmission(si, ~opaque), 1)
        segment.maxt = dr.select(hit, si.t, segment.maxt)
        left = shadow.light * through * left_over(scene, shadow.sampler, segment, shadow.active & ~opaque)
        light = dr.select(opaque, 0, left)
        way = None if shadow.way is None else longer(scene, shadow.way, segment, shadow.active & ~opaque)
        on = si.spawn_ray(segment.d)
        # Where the light lies on the surface, the ray has been moved past it.
        ahead = (ray.maxt == dr.inf) | (dr.dot(ray.o + ray.d - on.o, segment.d) > 0)
        goes_on = shadow.active & hit & (dr.max(light) > 0) & ahead
        return (Shadow(on.o, on.medium, light, way, shadow.sampler, goes_on),)

    (end,) = dr.while_loop((start,), lambda shadow: shadow.active, step, label="shadow")
    return end


def begun(scene: Scene, ray: Ray3f) -> Way:
    """The way of a shadow ray that hasn't left."""
    lengths = [Float(0) for _ in scene.media.plugins]
    return Way(lengths, Float(0), Point3f(0), Float(0), UInt32(scene.media.vacuum), own_stream(ray, ray.maxt))


def longer(scene: Scene, way: Way, segment: Ray3f, active: Bool) -> Way:
    """A way with one more segment: its uniform point moves there in proportion to the length."""
    lengths = [
        total + dr.select(active & (segment.medium == number), segment.maxt, 0)
        for number, total in enumerate(way.lengths)
    ]
    assert segment.medium is not None
    start, end = scene.media.in_box(segment, segment.maxt, scene.lookup)
    length = dr.select(active & (end < FAR), end - start, 0)
    place = way.stream.next_1d() * (way.tracked + length)
    here = (place < length) & (length > 0)
    return Way(
        lengths=lengths,
        tracked=way.tracked + length,
        o=dr.select(here, segment.o, way.o),
        at=dr.select(here, start + place, way.at),
        medium=dr.select(here, segment.medium, way.medium),
        stream=way.stream,
    )


def reattached(scene: Scene, sampler: SampleStream, ray: Ray3f, arrives: Color3f, way: Way) -> Color3f:
    """The share of light that arrives, with its derivatives by what the way through each medium leaves."""
    sigma_t = way.tracked * scene.media.extinction_at(
        way.medium,
        MediumInteraction3f.on(aimed(ray, way.o, way.medium), way.at),
        way.stream.next_1d(),
        scene.lookup,
        way.tracked > 0,
    )
    attached = arrives * (1 + (dr.detach(sigma_t) - sigma_t))
    for number, length in enumerate(way.lengths):
        if scene.media.plugins[number].is_tracked:
            continue
        segment = aimed(ray, ray.o, UInt32(number))
        segment.maxt = length
        left = left_over(scene, sampler, segment, Bool(False))
        fixed = dr.detach(left)
        attached = attached * dr.select(fixed > 0, left * dr.rcp(fixed), 1)
    return dr.replace_grad(arrives, attached)  # type: ignore[func-returns-value, return-value]


def aimed(ray: Ray3f, o: Point3f, medium: UInt32 | None) -> Ray3f:
    """The rest of a shadow ray from a point `o` on, with a unit direction.

    It is aimed again at the light: `o` was moved off a surface, and at a grazing angle the former direction would end
    behind the light.
    """
    finite = ray.maxt < dr.inf
    to_light = ray.o + ray.d - o
    distance = dr.norm(to_light)
    d = dr.select(finite, to_light * dr.rcp(distance), ray.d)
    return Ray3f(o, d, maxt=dr.select(finite, distance * (1 - SHADOW_EPSILON), dr.inf), medium=medium)


def left_over(scene: Scene, sampler: SampleStream, ray: Ray3f, active: Bool) -> Color3f:
    """The share of light that a medium leaves on a ray, up to its end."""
    if not scene.media or ray.medium is None:
        return Color3f(1)
    return scene.media.transmittance(ray, ray.maxt, scene.lookup, sampler, active)
