"""The machine schedule: a lane is a small state machine that walks one path after the other.

With triangles in a BVH, rays differ far more in length than paths do: a lane that waits for its
neighbours' rays wastes most of its time. Here a lane never waits for another's ray to end. It takes
steps through the tree for a ray of any kind, and when its own ray has ended it does what comes next:
process a path vertex, add the light that a shadow ray found free, or begin the next sample. Lanes of
one packet are all in different places at any time.

It is made for trees whose search is a sequence of steps. Where a search is one call, a turn is a whole
search, and the flat schedule is faster.

The estimator is the integrator's `vertex`, as in the flat schedule, with the same samples in the
same order. docs/performance.md, "Meshes", has the measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.dispatch.ensemble import Detached
from djpt.geometry.query import Query
from djpt.integrators.base import PathIntegrator, PathState
from djpt.jit.kernels import if_stmt, while_loop, wide
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.rendering.schedules.base import ModeOf, Schedule
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import TiledLanes
from djpt.rendering.schedules.sinks import Write, sample_buffers

if TYPE_CHECKING:
    from djpt.rendering.gradients.leaves import Numbering
    from djpt.rendering.gradients.modes import Mode

__all__ = ["Machine", "aligned_frame", "store"]


class Machine(Schedule):
    """Lanes are state machines, each with a ray that it traces at its own pace."""

    name = "machine"

    def samples(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        buffers, write = sample_buffers(job, band, end - begin)
        finished = run(job, TiledLanes(job, band, begin, end), write)
        dr.eval(finished, buffers)
        return buffers

    def replay(
        self, job: Job, values: Detached, numbering: Numbering, band: Band, begin: int, end: int, mode_of: ModeOf
    ) -> tuple[Mode, list[Float], UInt32]:
        from djpt.rendering.gradients import machine_replay

        lanes = TiledLanes(job, band, begin, end)
        mode = mode_of(lanes.count, UInt32())
        return mode, *machine_replay.run(job, values, numbering, lanes, mode)


@dataclass
class Lane:
    """Loop state."""

    query: Query
    """The ray that is being traced."""
    medium: UInt32 | None
    """The medium that the ray runs through; None in scenes without media."""
    shadow: Bool
    """True where the ray is a shadow ray."""
    pending: Color3f
    """The light that arrives if the shadow ray is free."""
    next_ray: Ray3f
    """The ray on which the path continues after the shadow ray."""
    active: Bool
    """True where the path continues."""
    valid: Bool
    """True where the sample counts as covered, if the path doesn't go on."""
    sampler: Any
    path: PathState
    radiance: Color3f
    entry: UInt32
    """The number of the lane's sample in its packet's list: see `TiledLanes`."""
    frame: Any
    """Memory that keeps the kernel's stack aligned: see `aligned_frame`."""


def run(job: Job, lanes: TiledLanes, write: Write) -> UInt32:
    """Advance all lanes until their samples are written; returns a number to evaluate."""
    integrator, derived = job.integrator.path_tracer, job.integrator.sample_channels
    scene, width = job.scene, lanes.count
    assert isinstance(integrator, PathIntegrator)
    geometry = scene.geometry
    first = lanes.at(lanes.first)
    sampler, ray, _ = job.begin(first.pixel, first.k, first.x, first.y)
    path = integrator.start(scene)
    start = Lane(
        query=wide(geometry.begin(ray, first.left, through_lights=integrator.passes_lights(path)), width),
        medium=wide(ray.medium, width),
        shadow=dr.full(Bool, False, width),
        pending=dr.zeros(Color3f, width),
        next_ray=wide(Ray3f(medium=ray.medium), width),
        active=dr.full(Bool, True, width),
        valid=dr.full(Bool, False, width),
        sampler=sampler,
        path=wide(path, width),
        radiance=dr.zeros(Color3f, width),
        entry=wide(lanes.first, width),
        frame=aligned_frame(width),
    )

    def advance(lane: Lane) -> Lane:
        """Process the end of a ray: a vertex, the light of an unoccluded shadow ray, or the next sample."""
        shadow = lane.shadow
        ray, hit = geometry.end(lane.query)
        ray.medium = lane.medium
        stream = lane.sampler.clone()
        blocked = hit.is_valid()
        # Shadow rays end at no vertex: packets without one skip the code of the BSDFs.
        hit.t = dr.select(shadow, dr.inf, hit.t)
        si = scene.surface_interaction(ray, hit, scene.surface_detail)
        v = integrator.advance(scene, stream, lane.path, ray, si)

        arrived = dr.select(shadow, dr.select(blocked, 0, lane.pending), v.emitted)
        radiance = lane.radiance + arrived
        lit = ~shadow & (dr.max(v.reflected) > 0)
        active, valid = dr.select(shadow, lane.active, v.active), dr.select(shadow, lane.valid, v.valid)
        next_ray = dr.select(shadow, lane.next_ray, v.ray)
        state = dr.select(shadow, lane.path, v.state)
        ended = ~lit & ~active
        here = lanes.at(lane.entry)
        channels = job.channels(radiance, valid, derived(radiance, valid))
        store(write, here.slot, channels, ended & here.exists)

        entry = lanes.next(lane.entry, ended)
        sample = lanes.at(entry)
        fresh, camera_ray, _ = job.begin(sample.pixel, sample.k, sample.x, sample.y)
        path = state.restarted(ended, integrator.start(scene))
        new_ray = dr.select(lit, v.shadow_ray, dr.select(ended, camera_ray, next_ray))
        return Lane(
            query=geometry.begin(new_ray, sample.left, lit, integrator.path_passes_lights(path, lit)),
            medium=new_ray.medium,
            shadow=lit,
            pending=v.reflected * scene.media.transmittance(v.shadow_ray),
            next_ray=next_ray,
            active=active,
            valid=valid,
            sampler=dr.select(ended, fresh, dr.select(shadow, lane.sampler, stream)),
            path=path,
            radiance=dr.select(ended, 0, radiance),
            entry=entry,
            frame=lane.frame,
        )

    def turn(lane: Lane) -> tuple[Lane]:
        through = integrator.path_passes_lights(lane.path, lane.shadow)
        lane.query.cursor = geometry.turn(lane.query, lane.shadow, through)
        (lane,) = if_stmt((lane,), lane.query.cursor.ended, lambda lane: (advance(lane),), lambda lane: (lane,))
        return (lane,)

    (end,) = while_loop((start,), lambda lane: lanes.left(lane.entry), turn, label="machine")
    return end.entry + end.frame.read(end.entry & 1)


def store(write: Write, slot: UInt32, channels: list[Float], active: Bool) -> None:
    """Write the samples of active lanes; skipped if there are none, since scattered writes are slow."""

    def stored(slot: UInt32, channels: list[Float]) -> UInt32:
        write(slot, channels, Bool(True))
        return slot

    if_stmt((slot, channels), active, stored, lambda slot, channels: slot)


def aligned_frame(width: int) -> Any:
    """A little memory per lane, which is there only for its effect on the kernel.

    A kernel that has some keeps its stack aligned to whole cache lines, and with it all registers that
    it has to spill.
    """
    memory = dr.alloc_local(UInt32, 2)
    for index in range(2):
        memory.write(dr.full(UInt32, 0, width), dr.full(UInt32, index, width))
    return memory
