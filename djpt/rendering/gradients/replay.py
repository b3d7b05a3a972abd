"""Path replay in the flat and the wave schedule: gradients with the memory of a picture, not of its paths.

Every lane computes each of its samples twice with the same random numbers. The first walk
gives the sample's radiance L. The second subtracts the contribution of each vertex, so that at a
vertex L is the light still to come through it, and differentiates

    Lo = emitted + reflected + L weight / detach(weight),

the only expression that depends on the parameters there (D. Vicini, S. Speierer and W. Jakob,
"Path Replay Backpropagation", SIGGRAPH 2021). Reverse mode adds delta . dLo to the parameters,
where delta is the derivative of the loss with respect to the sample; forward mode adds dLo to
the sample's derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.dispatch.ensemble import Detached
from djpt.integrators.base import PathIntegrator, PathState
from djpt.jit.kernels import wide
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.rendering.gradients.hit_cache import HitCache, empty_hit_cache
from djpt.rendering.gradients.leaves import Numbering
from djpt.rendering.gradients.modes import Mode
from djpt.rendering.gradients.zero_weights import begun, blank
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.lanes import Lanes
from djpt.rendering.schedules.unmasked_loop import run_free

__all__ = ["run"]


@dataclass
class Lane:
    """Loop state."""

    ray: Ray3f
    sampler: Any
    path: PathState
    radiance: Color3f
    """First walk: radiance so far. Second walk: radiance still to come."""
    behind: Color3f | None
    """See `djpt.rendering.gradients.zero_weights`."""
    again: Bool
    """True on the second walk."""
    number: UInt32 | None
    """The number of the vertex on its walk; None if no hits are cached."""
    k: UInt32
    slot: UInt32
    delta: Color3f
    """Reverse mode: derivative of the loss with respect to the sample. Forward mode: derivative of the sample."""
    sums: list[Float]


def run(
    job: Job, values: Detached, numbering: Numbering, lanes: Lanes, slots: UInt32, slot_stride: UInt32, mode: Mode
) -> tuple[list[Float], UInt32]:
    """Walk all samples twice; return the sums, and a number to evaluate if there are none.

    The rest of the state is dropped before anything is evaluated, and so never written to memory.
    """
    integrator, scene, count = job.integrator, job.scene, dr.width(lanes.pixel)
    assert isinstance(integrator, PathIntegrator)
    x, y = job.coordinates(lanes.pixel)
    sampler, ray, _ = job.begin(lanes.pixel, lanes.first, x, y)
    _, attached = mode.view(scene, values, numbering)
    cache = empty_hit_cache(integrator, scene, count)
    start = Lane(
        ray=wide(ray, count),
        sampler=sampler,
        path=wide(begun(integrator.begin(scene, sampler), attached), count),
        radiance=dr.zeros(Color3f, count),
        behind=blank(attached, count),
        again=dr.full(Bool, False, count),
        number=dr.zeros(UInt32, count) if cache else None,
        k=wide(lanes.first, count),
        slot=wide(slots, count),
        delta=wide(mode.delta_of(slots, Bool(True)), count),
        sums=mode.start(),
    )

    def body(lane: Lane, *cache: HitCache) -> Lane:
        leaves, view = mode.view(scene, values, numbering)
        queried, lit = scene, view
        if lane.number is not None:
            entry = cache[0].for_vertex(lane.number, lane.again)
            queried, lit = entry.in_scene(scene), entry.in_scene(view)
        si = integrator.trace(queried, lane.path, lane.ray)
        si.scene = view
        with dr.resume_grad():
            v = integrator.advance(view, lane.sampler, lane.path, lane.ray, si)
            arrived = integrator.transmittance(lit, lane.sampler, v)
        second = lane.again & (lane.k < lanes.end)
        lane.radiance, lane.behind, lane.delta, lane.sums = mode.visit(lane, leaves, v, arrived, second)

        ended = ~v.active
        finished = ended & second
        k = dr.select(finished, lane.k + lanes.stride, lane.k)
        next_slot = dr.select(finished, lane.slot + slot_stride, lane.slot)
        delta, sums = mode.hand_over(job, lane, finished, next_slot, finished & (k < lanes.end))
        fresh, camera_ray, _ = job.begin(lanes.pixel, k, x, y)
        restart = begun(integrator.begin(scene, fresh), attached)
        return Lane(
            ray=dr.select(ended, camera_ray, dr.detach(v.ray)),
            sampler=dr.select(ended, fresh, lane.sampler),
            path=dr.detach(v.state).restarted(ended, restart),
            radiance=dr.select(finished, 0, lane.radiance),
            behind=None if lane.behind is None else dr.select(finished, 0, lane.behind),
            again=lane.again ^ ended,
            number=None if lane.number is None else dr.select(ended, 0, lane.number + 1),
            k=k,
            slot=next_slot,
            delta=delta,
            sums=sums,
        )

    end = run_free(start, lambda lane: lane.k < lanes.end, body, count, mode.label, *cache)
    return end.sums, end.k
