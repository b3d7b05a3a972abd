"""The flat schedule: a lane is a pixel (or part of one) and starts a new path when one ends.

Paths differ in length. With one lane per sample a packet of lanes waits for its longest
path; here every lane always has a path to advance, and all state stays in registers. See
docs/performance.md for what that gives.

`radiance_sums` adds samples up within the lane and is all that a box filter needs;
`film_sums` also weights them with a wider filter; `radiance_samples` stores them, for images of
so many channels that sums per tap would not fit.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import drjit as dr

from djpt.integrators.base import PathIntegrator, PathState
from djpt.kernels import wide
from djpt.records import Ray3f
from djpt.schedules.job import Band, Job
from djpt.schedules.lanes import Lanes, interleaved, layered
from djpt.schedules.sinks import FilmSums, Finished, Sink, Store, Sums, blank_sums, sample_buffers
from djpt.types import Bool, Color3f, Float, Point2f, UInt32

__all__ = ["film_sums", "radiance_samples", "radiance_sums", "total"]


@dataclass
class Lane:
    """Loop state."""

    ray: Ray3f
    sampler: Any
    path: PathState
    radiance: Color3f
    held: Bool | None
    """The path has ended, but the sink couldn't take the sample yet. None: that never happens."""
    valid: Bool | None
    """Of a held sample: does it count as covered?"""
    offset: Point2f | None
    """Where on the pixel the sample lies; None if the sink doesn't ask."""
    k: UInt32
    """The sample of the pixel that the path belongs to."""
    sink: list[Any]


def run(job: Job, lanes: Lanes, sink: Sink) -> list[Any]:
    """Advance all lanes until the sink has their samples.

    Returns the sink's state.
    """
    integrator = job.integrator
    assert isinstance(integrator, PathIntegrator)
    scene, width = job.scene, dr.width(lanes.pixel)
    x, y = job.coordinates(lanes.pixel)
    several = sink.steps > 1
    sampler, ray, offset = job.begin(lanes.pixel, lanes.first, x, y)
    start = Lane(
        ray=wide(ray, width),
        sampler=sampler,
        path=wide(integrator.start(scene), width),
        radiance=dr.zeros(Color3f, width),
        held=dr.full(Bool, False, width) if several else None,
        valid=dr.full(Bool, False, width) if several else None,
        offset=offset if several else None,
        k=wide(lanes.first, width),
        sink=sink.state,
    )

    def step(lane: Lane, waiting: Finished | None) -> tuple[Lane, Finished | None]:
        si = integrator.trace(scene, lane.path, lane.ray)
        v = integrator.vertex(scene, lane.sampler, lane.path, lane.ray, si)
        visible = scene.unoccluded(v.shadow_ray)
        here = v.emitted + dr.select(visible, v.reflected, 0)
        ready, held = ~v.active, None
        valid: Any = v.valid
        if lane.held is not None:
            here, valid = dr.select(lane.held, 0, here), dr.select(lane.held, lane.valid, v.valid)
            ready = (ready | lane.held) & (lane.k < lanes.end)
        radiance = lane.radiance + here

        # The path has ended: hand over the sample, start the next one.
        channels = job.channels(radiance, valid, [])
        state, waiting, taken = sink.take(lane.sink, waiting, channels, lane.offset, ready)
        if lane.held is not None:
            held = ready & ~taken
        next_k = lane.k + lanes.stride
        fresh, camera_ray, offset = job.begin(lanes.pixel, next_k, x, y)
        after = Lane(
            ray=dr.select(taken, camera_ray, v.ray),
            sampler=dr.select(taken, fresh, lane.sampler),
            path=restart(taken, integrator.start(scene), v.state),
            radiance=dr.select(taken, 0, radiance),
            held=held,
            valid=None if held is None else valid,
            offset=None if lane.offset is None else dr.select(taken, offset, lane.offset),
            k=dr.select(taken, next_k, lane.k),
            sink=state,
        )
        return after, waiting

    def body(lane: Lane) -> tuple[Lane]:
        waiting = None
        for _ in range(sink.steps):
            lane, waiting = step(lane, waiting)
        lane.sink = sink.close(lane.sink, waiting)
        return (lane,)

    (finished,) = dr.while_loop((start,), lambda lane: lane.k < lanes.end, body, label="flat")
    return finished.sink


def restart(ended: Bool, fresh: PathState, state: PathState) -> PathState:
    """The fresh state where a path has ended."""

    def either(field: Any) -> Any:
        mine = getattr(state, field.name)
        # The previous vertex is never looked at before there is one: its density is 0.
        if mine is None or field.name in ("p", "n"):
            return mine
        return dr.select(ended, getattr(fresh, field.name), mine)

    return PathState(*map(either, fields(PathState)))


def radiance_sums(job: Job, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
    """Add the samples begin <= k < end of all pixels to `sums`, one array per channel.

    The sums are per lane: pass them on from pass to pass, and to `total` at the end.
    """
    lanes = interleaved(job, Band(0, job.height), begin, end)
    if sums is None:
        sums = blank_sums(dr.width(lanes.pixel), job.channel_count())
    result = run(job, lanes, Sums(sums))
    dr.eval(result)
    return result


def film_sums(job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
    """Add the samples begin <= k < end of a band to the film's sums by pixels, without storing them.

    The result goes to `spread`: the lanes of a pixel follow each other group by group.
    """
    lanes = interleaved(job, band, begin, end)
    if sums is None:
        sums = blank_sums(dr.width(lanes.pixel), job.film.taps**2 * (job.channel_count() + 1))
    sink = FilmSums(job, job.on_film(*job.coordinates(lanes.pixel)), sums)
    result = run(job, lanes, sink)
    dr.eval(result)
    return result


def total(job: Job, sums: list[Float]) -> list[Float]:
    """The per-pixel sums over a pixel's lanes."""
    pixels = job.width * job.height
    groups = dr.width(sums[0]) // pixels
    count, pixel = dr.opaque(UInt32, groups), dr.arange(UInt32, pixels)
    stride = dr.opaque(UInt32, pixels)

    def body(g: UInt32, out: list[Float]) -> tuple[UInt32, list[Float]]:
        return g + 1, [o + dr.gather(Float, s, dr.fma(g, stride, pixel)) for o, s in zip(out, sums, strict=True)]

    start = blank_sums(pixels, len(sums))
    _, result = dr.while_loop((dr.zeros(UInt32, pixels), start), lambda g, out: g < count, body, label="total")
    dr.eval(result)
    return result


def radiance_samples(job: Job, band: Band, begin: int, end: int) -> list[Float]:
    """The samples begin <= k < end of a band's pixels: per channel an array [k - begin][pixel]."""
    lanes = layered(job, band, begin, end)
    buffers, write = sample_buffers(job, band, end - begin)
    run(job, lanes, Store(dr.width(lanes.pixel), write))
    dr.eval(buffers)
    return buffers
