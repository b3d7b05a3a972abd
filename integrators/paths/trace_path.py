"""One path per lane, from its camera ray to its end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.jit.kernels import loop_traced_once, wide
from djpt.jit.types import Bool, Color3f, Point3f, UInt32, Vector3f
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.integrators.base import PathIntegrator, PathState
    from djpt.scene.scene import Scene

__all__ = ["trace_path"]


@dataclass
class PathLoop:
    """Loop state of one path per lane."""

    o: Point3f
    d: Vector3f
    medium: UInt32 | None
    times: Any
    """Time of the ray, see `Ray3f.times`: a tuple, whose type Dr.Jit needn't know."""
    sampler: SampleStream
    state: Any
    """A `PathState`; the type is `Any`, because Dr.Jit would look for the name in this module."""
    radiance: list[Color3f]
    valid: Bool
    active: Bool


def trace_path(
    integrator: PathIntegrator,
    scene: Scene,
    sampler: SampleStream,
    ray: Ray3f,
    active: Bool | bool = True,
    bounces: int = 0,
    state: PathState | None = None,
) -> tuple[list[Color3f], Bool]:
    """Follow one path per lane to its end, and return its radiance and whether it counts as covered.

    With `bounces` = n, the radiance comes in n parts, for light that was scattered 0 to n - 1 times. Paths begin as
    the integrator says, or with a given `state`.
    """
    lanes = dr.width(ray, sampler)
    start = PathLoop(
        o=wide(ray.o, lanes),
        d=wide(ray.d, lanes),
        medium=wide(ray.medium, lanes),
        times=wide(ray.times, lanes),
        sampler=sampler,
        state=wide(integrator.begin(scene, sampler) if state is None else state, lanes),
        radiance=[dr.zeros(Color3f, lanes) for _ in range(max(1, bounces))],
        valid=dr.full(Bool, False, lanes),
        active=Bool(active) & dr.full(Bool, True, lanes),
    )

    def body(lane: PathLoop) -> tuple[PathLoop]:
        # Only the first ray may have an end. As loop state it would nearly always stay infinite, and Dr.Jit traces
        # a loop again when it finds that something stays what it is.
        way = Ray3f(lane.o, lane.d, maxt=dr.select(lane.state.depth == 0, ray.maxt, dr.inf), medium=lane.medium)
        way.times = lane.times
        si = integrator.trace(scene, lane.state, way)
        v = integrator.advance(scene, lane.sampler, lane.state, way, si)
        reflected, depth = integrator.transmittance(scene, lane.sampler, v), lane.state.depth
        if bounces:
            radiance = [
                r + dr.select(depth == k, v.emitted, dr.select(depth + 1 == k, reflected, 0))
                for k, r in enumerate(lane.radiance)
            ]
        else:
            radiance = [lane.radiance[0] + v.emitted + reflected]
        valid = dr.select(v.active, lane.valid, v.valid)
        on = v.ray
        return (PathLoop(on.o, on.d, on.medium, on.times, lane.sampler, v.state, radiance, valid, v.active),)

    (end,) = loop_traced_once(start, lambda lane: lane.active, body, type(integrator).__name__)
    return end.radiance, end.valid
