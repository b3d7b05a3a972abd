"""Path replay in the flat and the wave schedule: gradients with the memory of a picture, not of its paths.

Every lane computes each of its samples twice with the same random numbers. The first walk
gives the sample's radiance L. The second subtracts the contribution of each vertex, so that at a
vertex L is the light still to come through it, and differentiates

    Lo = emitted + reflected + L weight / detach(weight),

the only expression that depends on the parameters there (D. Vicini, S. Speierer and W. Jakob,
"Path Replay Backpropagation", SIGGRAPH 2021). Reverse mode adds delta . dLo to the parameters,
where delta is the derivative of the loss with respect to the sample; forward mode adds dLo to
the sample's derivative.

Both walks of a sample follow each other in a lane, in one loop. Where a mode differentiates a vertex by long code, and
no hits are cached between the walks, all samples have their first walks in a loop of its own, which stores what they
find: that code runs on second walks alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.dispatch.ensemble import Detached
from djpt.integrators.base import PathIntegrator, PathState
from djpt.jit.kernels import wide
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.rendering.gradients.hit_cache import HitCache, empty_hit_cache
from djpt.rendering.gradients.leaves import Numbering
from djpt.rendering.gradients.modes import Mode
from djpt.rendering.gradients.zero_weights import begun, blank, collected
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.lanes import Lanes
from djpt.rendering.schedules.unmasked_loop import run_free
from djpt.scene.scene import Scene

__all__ = ["MOST", "FirstWalks", "first_walks", "run"]


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
    turn: Bool | None
    """True on the second walk; None if there are no others."""
    number: UInt32 | None
    """The number of the vertex on its walk; None if no hits are cached."""
    k: UInt32
    slot: UInt32
    delta: Color3f
    """Reverse mode: derivative of the loss with respect to the sample. Forward mode: derivative of the sample."""
    sums: list[Float]

    @property
    def again(self) -> Bool:
        """True on the second walk."""
        return Bool(True) if self.turn is None else self.turn


MOST = 2**22
"""The number of samples whose first walks may be stored, in 50 or 100 MB."""


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
    known = None
    if mode.takes_long and not cache and job.samples <= MOST:
        known = first_walks(job, attached, lanes, slots, slot_stride, lambda path: begun(path, attached))
    radiance, behind = (dr.zeros(Color3f, count), blank(attached, count)) if known is None else known.at(slots, True)
    start = Lane(
        ray=wide(ray, count),
        sampler=sampler,
        path=wide(begun(integrator.begin(scene, sampler), attached), count),
        radiance=wide(radiance, count),
        behind=None if behind is None else wide(behind, count),
        turn=dr.full(Bool, False, count) if known is None else None,
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
        more = finished & (k < lanes.end)
        delta, sums = mode.hand_over(job, lane, finished, next_slot, more)
        radiance, behind = (Color3f(0), Color3f(0)) if known is None else known.at(next_slot, more)
        fresh, camera_ray, _ = job.begin(lanes.pixel, k, x, y)
        restart = begun(integrator.begin(scene, fresh), attached)
        return Lane(
            ray=dr.select(ended, camera_ray, dr.detach(v.ray)),
            sampler=dr.select(ended, fresh, lane.sampler),
            path=dr.detach(v.state).restarted(ended, restart),
            radiance=dr.select(finished, radiance, lane.radiance),
            behind=None if lane.behind is None else dr.select(finished, behind, lane.behind),
            turn=None if lane.turn is None else lane.turn ^ ended,
            number=None if lane.number is None else dr.select(ended, 0, lane.number + 1),
            k=k,
            slot=next_slot,
            delta=delta,
            sums=sums,
        )

    end = run_free(start, lambda lane: lane.k < lanes.end, body, count, mode.label, *cache)
    return end.sums, end.k


# ---- first walks ---------------------------------------------------------------------------


@dataclass
class FirstWalks:
    """What the first walks of all samples found, by slots."""

    radiance: list[Float]
    behind: list[Float]
    """Empty if nothing is set aside."""

    def at(self, slot: UInt32, active: Bool | bool) -> tuple[Color3f, Color3f | None]:
        """The radiance of a sample, and the light `behind`."""
        radiance, behind = (
            [dr.gather(Float, channel, slot, active) for channel in part] for part in (self.radiance, self.behind)
        )
        return Color3f(*radiance), Color3f(*behind) if behind else None


@dataclass
class FirstLane:
    """Loop state of first walks, as in `Lane`."""

    ray: Ray3f
    sampler: Any
    path: PathState
    radiance: Color3f
    behind: Color3f | None
    k: UInt32
    slot: UInt32


def first_walks(
    job: Job,
    scene: Scene,
    lanes: Lanes,
    slots: UInt32,
    slot_stride: UInt32,
    prepared: Callable[[PathState], PathState],
) -> FirstWalks:
    """Follow all samples once.

    `scene` is the view of the second walk: what has derivatives decides where paths go on. `prepared` adds to the state
    of a path that begins what the second walk needs.
    """
    integrator, count = job.integrator, dr.width(lanes.pixel)
    assert isinstance(integrator, PathIntegrator)
    x, y = job.coordinates(lanes.pixel)
    sampler, ray, _ = job.begin(lanes.pixel, lanes.first, x, y)
    start = FirstLane(
        ray=wide(ray, count),
        sampler=sampler,
        path=wide(prepared(integrator.begin(job.scene, sampler)), count),
        radiance=dr.zeros(Color3f, count),
        behind=blank(scene, count),
        k=wide(lanes.first, count),
        slot=wide(slots, count),
    )
    radiance, behind = ([dr.empty(Float, job.samples) for _ in range(3)] for _ in range(2))
    found = FirstWalks(radiance, [] if start.behind is None else behind)
    memory = [*found.radiance, *found.behind]

    def body(lane: FirstLane) -> FirstLane:
        si = integrator.trace(job.scene, lane.path, lane.ray)
        si.scene = scene
        with dr.resume_grad():
            v = integrator.advance(scene, lane.sampler, lane.path, lane.ray, si)
            here = dr.detach(v.emitted + integrator.transmittance(scene, lane.sampler, v))
        gained, behind = collected(lane.path.zero_weight, lane.behind, here)
        radiance, ended = lane.radiance + gained, ~v.active
        finished = ended & (lane.k < lanes.end)
        values = [*radiance] if behind is None else [*radiance, *behind]
        for channel, value in zip(memory, values, strict=True):
            dr.scatter(channel, value, lane.slot, finished)
        k = dr.select(finished, lane.k + lanes.stride, lane.k)
        fresh, camera_ray, _ = job.begin(lanes.pixel, k, x, y)
        restart = prepared(integrator.begin(job.scene, fresh))
        return FirstLane(
            ray=dr.select(ended, camera_ray, dr.detach(v.ray)),
            sampler=dr.select(ended, fresh, lane.sampler),
            path=dr.detach(v.state).restarted(ended, restart),
            radiance=dr.select(ended, 0, radiance),
            behind=None if behind is None else dr.select(ended, 0, behind),
            k=k,
            slot=dr.select(finished, lane.slot + slot_stride, lane.slot),
        )

    end = run_free(start, lambda lane: lane.k < lanes.end, body, count, "replay first")
    with small_blocks():
        dr.eval(end.k, memory)
    return found
