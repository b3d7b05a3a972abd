"""Shadow rays through null surfaces and media."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.kernels import wide
from djpt.records import SHADOW_EPSILON, BSDFFlags, Ray3f, has_flag
from djpt.samplers.base import SampleStream, go_on_with
from djpt.types import Bool, Color3f, Float, Point3f, UInt32

if TYPE_CHECKING:
    from djpt.scene import Scene

__all__ = ["light_through_null"]


@dataclass
class Shadow:
    """A shadow ray on its way: loop state."""

    o: Point3f
    medium: UInt32 | None
    light: Color3f
    lengths: list[Float]
    """The length of the way so far through each medium; empty unless there are derivatives."""
    sampler: Any
    active: Bool


def light_through_null(
    scene: Scene, sampler: SampleStream, ray: Ray3f, light: Color3f, lit: Bool | None = None
) -> Color3f:
    """The part of `light` that arrives along a shadow ray, through null surfaces and whatever media lie between.

    Unlike `Scene.light_through` it leaves out no shape: a point in a medium may lie behind a wall that stands around
    everything else. It has derivatives by the media and by `light`; those of null surfaces are left out. Where `lit`,
    the way is followed although `light` is black.
    """
    shines = dr.max(light) > 0
    lit = shines if lit is None else shines | lit
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
    if differentiable:
        arrives = reattached(scene, sampler, ray, arrives, end.lengths)
    return light * arrives


def walked(scene: Scene, sampler: SampleStream, ray: Ray3f, light: Color3f, lit: Bool, measured: bool) -> Shadow:
    """The end of a shadow ray that starts with `light`; with the lengths in each medium if `measured`."""
    lanes = dr.width(ray, lit, sampler)
    start = Shadow(
        o=wide(ray.o, lanes),
        medium=wide(ray.medium, lanes),
        light=wide(light, lanes),
        lengths=[dr.zeros(Float, lanes) for _ in scene.media.plugins] if measured else [],
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
        lengths = [
            total + dr.select(shadow.active & (shadow.medium == number), segment.maxt, 0)
            for number, total in enumerate(shadow.lengths)
        ]
        on = si.spawn_ray(segment.d)
        # Where the light lies on the surface, the ray has been moved past it.
        ahead = (ray.maxt == dr.inf) | (dr.dot(ray.o + ray.d - on.o, segment.d) > 0)
        goes_on = shadow.active & hit & (dr.max(light) > 0) & ahead
        return (Shadow(on.o, on.medium, light, lengths, shadow.sampler, goes_on),)

    (end,) = dr.while_loop((start,), lambda shadow: shadow.active, step, label="shadow")
    return end


def reattached(scene: Scene, sampler: SampleStream, ray: Ray3f, arrives: Color3f, lengths: Sequence[Float]) -> Color3f:
    """The share of light that arrives, with its derivatives by what the way through each medium leaves."""
    attached = arrives
    for number, length in enumerate(lengths):
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
