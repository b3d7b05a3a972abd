"""The flat schedule: a lane is a pixel (or part of one) and starts a new path when one ends.

Paths differ in length. With one lane per sample a packet of lanes waits for its longest
path; here every lane always has a path to advance, and all state stays in registers. See
docs/performance.md for what that gives.

`radiance_sums` adds samples up within the lane and is all that a box filter needs;
`film_sums` also weights them with a wider filter; `Flat.samples` stores them, for images of
so many channels that sums per tap would not fit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.dispatch.ensemble import Detached
from djpt.geometry.query import Hit
from djpt.integrators.base import PathIntegrator, PathState, Vertex
from djpt.jit.kernels import computed_where, wide
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32
from djpt.rendering.schedules.base import ModeOf, Schedule
from djpt.rendering.schedules.called_sums import CalledSums, Taps, reader, usable
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import Lanes, interleaved, layered, one_by_one
from djpt.rendering.schedules.passes import filtered_rows, summed_rows
from djpt.rendering.schedules.reconstruction import Rows, Summed, by_pixels, collect
from djpt.rendering.schedules.sinks import (
    CalledFilmSums,
    FilmSums,
    Finished,
    Sink,
    Store,
    Sums,
    blank_sums,
    sample_buffers,
)
from djpt.rendering.schedules.unmasked_loop import run_free

if TYPE_CHECKING:
    from djpt.rendering.gradients.leaves import Numbering
    from djpt.rendering.gradients.modes import Mode

__all__ = ["Flat"]


class Flat(Schedule):
    """One lane per pixel, or several lanes that share the samples of a pixel."""

    name = "flat"

    def rows(self, job: Job) -> Iterator[Summed]:
        if not job.film.filters:
            return summed_rows(job, radiance_sums)
        if usable(Taps(job.film.taps, job.channel_count()), job.film.rfilter()):
            return filtered_rows(job, called_film_sums, spread=spread_called)
        if by_pixels(job, job.channel_count() + 1):
            return filtered_rows(job, film_sums)
        return super().rows(job)

    def samples(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        lanes = layered(job, band, begin, end)
        buffers, write = sample_buffers(job, band, end - begin)
        run(job, lanes, Store(dr.width(lanes.pixel), write))
        with small_blocks():
            dr.eval(buffers)
        return buffers

    def carries_sums(self, job: Job) -> bool:
        return not job.film.filters

    def replay(
        self,
        job: Job,
        values: Detached,
        numbering: Numbering,
        band: Band,
        begin: int,
        end: int,
        mode_of: ModeOf,
        shared: bool = True,
    ) -> tuple[Mode, list[Float], UInt32]:
        """As `Schedule.replay`; if not `shared`, all samples of a pixel are in one lane."""
        from djpt.rendering.gradients import extinction_walk, replay, single_walk

        if shared:
            lanes = (interleaved if self.carries_sums(job) else layered)(job, band, begin, end)
        else:
            lanes = one_by_one(job, band, begin, end)
        count = dr.width(lanes.pixel)
        mode = mode_of(count, lanes.pixel)
        # The opaque zero is needed: Dr.Jit turns a gather of all entries in order into a plain load, which
        # would give images of one sample per pixel a kernel of their own.
        slots = dr.arange(UInt32, count) + dr.opaque(UInt32, 0)
        if extinction_walk.needed(job.scene, numbering):
            run = extinction_walk.run
        else:
            run = single_walk.run if single_walk.possible(mode) else replay.run
        return mode, *run(job, values, numbering, lanes, slots, dr.opaque(UInt32, count), mode)


@dataclass
class Lane:
    """Loop state."""

    ray: Ray3f
    sampler: Any
    path: PathState
    radiance: Color3f
    held: Bool | None
    """True where the path has ended, but the sink couldn't take the sample yet; None if it always can."""
    valid: Bool | None
    """True where a held sample counts as covered."""
    offset: Point2f | None
    """The place of the sample on its pixel; None if the sink doesn't need it."""
    aovs: list[Float]
    """The channels that follow from the path's camera ray."""
    k: UInt32
    """The number of the path's sample, among those of its pixel."""
    sink: list[Any]
    hit: Hit | None = None
    """The first hit of the ray, if it was searched for together with a ray to a light."""


def run(job: Job, lanes: Lanes, sink: Sink) -> list[Any]:
    """Advance all lanes until the sink has their samples.

    Returns the sink's state.
    """
    integrator, derived = job.integrator.path_tracer, job.integrator.sample_channels
    assert isinstance(integrator, PathIntegrator)
    scene, width = job.scene, dr.width(lanes.pixel)
    x, y = job.coordinates(lanes.pixel)
    several = sink.steps > 1
    in_pairs = integrator.searches_pairs(scene) and not several
    sampler, ray, offset = job.begin(lanes.pixel, lanes.first, x, y)
    start = Lane(
        ray=wide(ray, width),
        sampler=sampler,
        path=wide(integrator.begin(scene, sampler), width),
        radiance=dr.zeros(Color3f, width),
        held=dr.full(Bool, False, width) if several else None,
        valid=dr.full(Bool, False, width) if several else None,
        offset=offset if sink.needs_offset else None,
        aovs=wide(job.integrator.camera_channels(scene, ray), width),
        k=wide(lanes.first, width),
        sink=sink.state,
    )
    if in_pairs:
        start.hit = wide(scene.geometry.first_hit(start.ray, integrator.passes_lights(start.path)), width)

    def aovs_of(lane: Lane, begun: Bool, ray: Ray3f) -> list[Float]:
        """The channels of the camera rays of samples that have begun; of the others those that there are."""
        if not lane.aovs:
            return []
        new = computed_where(begun, lambda: job.integrator.camera_channels(scene, ray.replaced()), label="aovs")
        return [dr.select(begun, value, old) for value, old in zip(new, lane.aovs, strict=True)]

    def moved_on(lane: Lane, v: Vertex, taken: Bool) -> Lane:
        """The lane on the way to its next vertex; where its sample was `taken`, at the camera of the next one."""
        next_k = lane.k + lanes.stride
        fresh, camera_ray, offset = job.begin(lanes.pixel, next_k, x, y)
        begun = integrator.begin(scene, fresh)
        return replace(
            lane,
            ray=dr.select(taken, camera_ray, v.ray),
            sampler=dr.select(taken, fresh, lane.sampler),
            path=v.state.restarted(taken, begun),
            offset=None if lane.offset is None else dr.select(taken, offset, lane.offset),
            aovs=aovs_of(lane, taken, camera_ray),
            k=dr.select(taken, next_k, lane.k),
        )

    def step(lane: Lane, waiting: Finished | None) -> tuple[Lane, Finished | None]:
        if lane.hit is None:
            si = integrator.trace(scene, lane.path, lane.ray, lane.sampler)
        else:
            si = scene.surface_interaction(lane.ray, scene.geometry.intersection(lane.hit), scene.surface_detail)
        v = integrator.advance(scene, lane.sampler, lane.path, lane.ray, si)
        running = lane.k < lanes.end
        ready, held = ~v.active & running, None
        after = None
        if lane.hit is None:
            light = integrator.transmittance(scene, lane.sampler, v)
        else:
            # One vertex per turn: the sink takes all samples at once.
            after = moved_on(lane, v, ready)
            through = integrator.passes_lights(after.path)
            after.hit, light = scene.next_hit(after.ray, v.shadow_ray, v.reflected, through)
        here = v.emitted + light
        valid: Any = v.valid
        if lane.held is not None:
            here, valid = dr.select(lane.held, 0, here), dr.select(lane.held, lane.valid, v.valid)
            ready = ready | (lane.held & running)
        radiance = lane.radiance + here

        # The path has ended: hand over the sample, start the next one.
        channels = job.channels(radiance, valid, [*derived(radiance, valid), *lane.aovs])
        state, waiting, taken = sink.take(lane.sink, waiting, channels, lane.offset, ready)
        if lane.held is not None:
            held = ready & ~taken
        after = moved_on(lane, v, taken) if after is None else after
        after.radiance = dr.select(taken, 0, radiance)
        after.held, after.valid = held, None if held is None else valid
        after.sink = state
        return after, waiting

    def body(lane: Lane) -> Lane:
        waiting = None
        for _ in range(sink.steps):
            lane, waiting = step(lane, waiting)
        lane.sink = sink.close(lane.sink, waiting)
        return lane

    return run_free(start, lambda lane: lane.k < lanes.end, body, width, "flat").sink


def radiance_sums(job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
    """Add the samples begin <= k < end of a band to `sums`, one array per channel.

    The sums are per lane: pass them on from pass to pass, and to `total` at the end.
    """
    lanes = interleaved(job, band, begin, end)
    if sums is None:
        sums = blank_sums(dr.width(lanes.pixel), job.channel_count())
    result = run(job, lanes, Sums(sums))
    with small_blocks():
        dr.eval(result)
    return result


def called_film_sums(job: Job, band: Band, begin: int, end: int, memory: list[Float] | None) -> list[Float]:
    """Add the samples begin <= k < end of a band to the film's sums by calls; the result goes to `spread_called`."""
    lanes = interleaved(job, band, begin, end)
    taps, width = Taps(job.film.taps, job.channel_count()), dr.width(lanes.pixel)
    sums = CalledSums(taps, job.film.rfilter(), width, None if memory is None else memory[0])
    # A call takes time, which shows where vertices are cheap. A loop of one vertex is compiled in half the time.
    steps = 1 if job.scene.geometry.has_trees else 2
    count = run(job, lanes, CalledFilmSums(job.on_film(*job.coordinates(lanes.pixel)), sums, steps))
    with small_blocks():
        dr.eval(count)
    return [sums.memory]


def spread_called(job: Job, band: Band, memory: list[Float], rows: Rows) -> list[Float]:
    """Add a finished band's sums in memory to those of the rows in its reach."""
    taps = Taps(job.film.taps, job.channel_count())
    return collect(job, band, dr.width(memory[0]) // taps.sums, lambda row: reader(memory[0], taps, row), rows)


def film_sums(job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
    """Add the samples begin <= k < end of a band to the film's sums by pixels, without storing them.

    The result goes to `collected`: the lanes of a pixel stand side by side.
    """
    lanes = interleaved(job, band, begin, end)
    if sums is None:
        sums = blank_sums(dr.width(lanes.pixel), job.film.taps**2 * (job.channel_count() + 1))
    sink = FilmSums(job, job.on_film(*job.coordinates(lanes.pixel)), sums)
    result = run(job, lanes, sink)
    with small_blocks():
        dr.eval(result)
    return result
