"""The flat schedule: a lane is a pixel (or part of one) and starts a new path when one ends.

Paths differ in length. With one lane per sample a packet of lanes waits for its longest
path; here every lane always has a path to advance, and all state stays in registers. See
docs/performance.md for what that gives.

`radiance_sums` adds samples up within the lane and is all that a box filter needs;
`film_sums` also weights them with a wider filter; `radiance_samples` stores them, for images of
so many channels that sums per tap would not fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.integrators.base import PathIntegrator, PathState, wide
from djpt.records import Ray3f
from djpt.schedules.job import Band, Job
from djpt.schedules.sinks import FilmSums, Finished, Sink, Store, Sums, blank_sums
from djpt.types import Bool, Color3f, Float, Point2f, UInt32

__all__ = ["film_sums", "lanes_per_pixel", "radiance_samples", "radiance_sums", "total"]

LANES = 2**16
"""Fewer lanes leave processor cores idle: Dr.Jit hands them out in blocks of 2^14."""


def lanes_per_pixel(pixels: int, spp: int) -> int:
    """How many lanes share a pixel's samples: a power of two that depends on the image alone.

    A lane with many samples in a row evens out the lengths of its paths, so pixels are shared only
    where there are few of them.
    """
    lanes = 1
    while pixels * lanes < LANES and lanes < 64 and spp // (2 * lanes) >= 4:
        lanes *= 2
    return lanes


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


def run(job: Job, pixel: UInt32, first: UInt32, end: UInt32, stride: UInt32, sink: Sink) -> list[Any]:
    """Advance all lanes until the sink has their samples first, first + stride, .. below `end`.

    Returns the sink's state.
    """
    integrator = job.integrator
    assert isinstance(integrator, PathIntegrator)
    scene, lanes = job.scene, dr.width(pixel)
    x, y = job.coordinates(pixel)
    several = sink.steps > 1
    sampler, ray, offset = job.begin(pixel, first, x, y)
    start = Lane(
        ray=wide(ray, lanes),
        sampler=sampler,
        path=wide(integrator.start(scene), lanes),
        radiance=dr.zeros(Color3f, lanes),
        held=dr.full(Bool, False, lanes) if several else None,
        valid=dr.full(Bool, False, lanes) if several else None,
        offset=offset if several else None,
        k=wide(first, lanes),
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
            ready = (ready | lane.held) & (lane.k < end)
        radiance = lane.radiance + here

        # The path has ended: hand over the sample, start the next one.
        channels = job.channels(radiance, valid, [])
        state, waiting, taken = sink.take(lane.sink, waiting, channels, lane.offset, ready)
        if lane.held is not None:
            held = ready & ~taken
        next_k = lane.k + stride
        fresh, camera_ray, offset = job.begin(pixel, next_k, x, y)
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

    (finished,) = dr.while_loop((start,), lambda lane: lane.k < end, body, label="flat")
    return finished.sink


def restart(ended: Bool, fresh: PathState, state: PathState) -> PathState:
    """The fresh state where a path has ended."""
    eta = None if state.eta is None else dr.select(ended, fresh.eta, state.eta)
    return PathState(
        state.p,
        dr.select(ended, fresh.throughput, state.throughput),
        dr.select(ended, fresh.bsdf_pdf, state.bsdf_pdf),
        eta,
        dr.select(ended, fresh.depth, state.depth),
    )


def first_sample(group: UInt32, groups: UInt32, begin: UInt32) -> UInt32:
    """The first k >= begin with k = group (mod groups); `groups` is a power of two."""
    return begin + ((group - begin) & (groups - 1))


def radiance_sums(job: Job, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
    """Add the samples begin <= k < end of all pixels to `sums`, one array per channel.

    The sums are per lane, `lanes_per_pixel` of them for each pixel, group by group: pass them on
    from pass to pass, and to `total` at the end. Lane g of a pixel owns the samples k = g modulo
    the number of lanes, so the order of additions doesn't depend on the passes.
    """
    pixels = job.width * job.height
    lanes = pixels * lanes_per_pixel(pixels, job.spp)
    groups = dr.opaque(UInt32, lanes // pixels)
    index, count = dr.arange(UInt32, lanes), dr.opaque(UInt32, pixels)
    group = index // count
    pixel = index - group * count
    if sums is None:
        sums = blank_sums(lanes, job.channel_count())
    first = first_sample(group, groups, dr.opaque(UInt32, begin))
    result = run(job, pixel, first, dr.opaque(UInt32, end), groups, Sums(sums))
    dr.eval(result)
    return result


def film_sums(job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
    """Add the samples begin <= k < end of a band to the film's sums by pixels, without storing them.

    The result goes to `spread`: the lanes of a pixel follow each other group by group.
    """
    count = lanes_per_pixel(job.width * job.height, job.spp)
    pixels = band.rows * job.width
    index, size, groups = dr.arange(UInt32, pixels * count), dr.opaque(UInt32, pixels), dr.opaque(UInt32, count)
    group = index // size
    pixel = index - group * size + dr.opaque(UInt32, band.first_row * job.width)
    if sums is None:
        sums = blank_sums(pixels * count, job.film.taps**2 * (job.channel_count() + 1))
    first = first_sample(group, groups, dr.opaque(UInt32, begin))
    sink = FilmSums(job, job.on_film(*job.coordinates(pixel)), sums)
    result = run(job, pixel, first, dr.opaque(UInt32, end), groups, sink)
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
    pixels = band.rows * job.width
    buffers = [dr.empty(Float, pixels * (end - begin)) for _ in range(job.channel_count())]
    size = dr.opaque(UInt32, pixels)

    def store(slot: UInt32, channels: list[Float], active: Bool) -> None:
        for buffer, channel in zip(buffers, channels, strict=True):
            dr.scatter(buffer, channel, slot, active)

    groups = samples_in_parallel(pixels, end - begin)
    lane = dr.arange(UInt32, pixels * groups)
    group = lane // size
    pixel = lane - group * size + dr.opaque(UInt32, band.first_row * job.width)
    first = dr.opaque(UInt32, begin) + group
    run(job, pixel, first, dr.opaque(UInt32, end), dr.opaque(UInt32, groups), Store(pixels * groups, store))
    dr.eval(buffers)
    return buffers


def samples_in_parallel(pixels: int, count: int) -> int:
    """Lanes per pixel of a pass that stores its samples; they don't change the result."""
    lanes = 1
    while pixels * lanes < LANES and count % (2 * lanes) == 0 and count // (2 * lanes) >= 8:
        lanes *= 2
    return lanes
