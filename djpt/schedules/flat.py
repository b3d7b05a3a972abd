"""The flat schedule: a lane is a pixel (or part of one) and starts a new path when one ends.

Paths differ in length. With one lane per sample a packet of lanes waits for its longest
path; here every lane always has a path to advance, and all state stays in registers. See
docs/performance.md for what that gives.

`radiance_sums` adds samples up within the lane and is all that a box filter needs;
`radiance_samples` stores them for the film.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.integrators.base import PathIntegrator, PathState, wide
from djpt.records import Ray3f
from djpt.schedules.job import Band, Job
from djpt.types import Bool, Color3f, Float, UInt32

__all__ = ["lanes_per_pixel", "radiance_samples", "radiance_sums"]

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
    k: UInt32
    """The sample of the pixel that the path belongs to."""
    sink: list[Float]
    """What finished samples are added to (one sum per channel), or nothing."""
    slot: UInt32
    """Where the sample will be stored."""


def run(job: Job, pixel: UInt32, first: UInt32, end: UInt32, stride: UInt32, sums: list[Float], store: Any) -> Lane:
    """Advance all lanes until each has finished its samples first, first + stride, .. below `end`.

    A finished sample is added to `sums`, or given to ``store(slot, channels, active)``.
    """
    integrator = job.integrator
    assert isinstance(integrator, PathIntegrator)
    scene, lanes = job.scene, dr.width(pixel)
    x, y = job.coordinates(pixel)
    slot_stride = dr.opaque(UInt32, lanes)
    sampler = job.stream(pixel, first)
    ray = job.camera_ray(sampler, x, y)
    start = Lane(
        ray=wide(ray, lanes),
        sampler=sampler,
        path=wide(integrator.start(scene), lanes),
        radiance=dr.zeros(Color3f, lanes),
        k=wide(first, lanes),
        sink=sums,
        slot=dr.arange(UInt32, lanes),
    )

    def body(lane: Lane) -> tuple[Lane]:
        si = integrator.trace(scene, lane.path, lane.ray)
        v = integrator.vertex(scene, lane.sampler, lane.path, lane.ray, si)
        visible = scene.unoccluded(v.shadow_ray)
        radiance = lane.radiance + v.emitted + dr.select(visible, v.reflected, 0)

        # The path has ended: hand over the sample, start the next one.
        ended = ~v.active
        channels = job.channels(radiance, v.valid, [])
        if store is None:
            sink = [s + dr.select(ended, c, 0) for s, c in zip(lane.sink, channels, strict=True)]
            slot = lane.slot
        else:
            store(lane.slot, channels, ended)
            sink, slot = lane.sink, dr.select(ended, lane.slot + slot_stride, lane.slot)
        k = dr.select(ended, lane.k + stride, lane.k)
        fresh = job.stream(pixel, lane.k + stride)
        camera_ray = job.camera_ray(fresh, x, y)
        return (
            Lane(
                ray=dr.select(ended, camera_ray, v.ray),
                sampler=dr.select(ended, fresh, lane.sampler),
                path=restart(ended, integrator.start(scene), v.state),
                radiance=dr.select(ended, 0, radiance),
                k=k,
                sink=sink,
                slot=slot,
            ),
        )

    (end_state,) = dr.while_loop((start,), lambda lane: lane.k < end, body, label="flat")
    return end_state


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
    result = run(job, pixel, first, dr.opaque(UInt32, end), groups, sums, None).sink
    dr.eval(result)
    return result


def blank_sums(lanes: int, count: int) -> list[Float]:
    """Zeros in memory: as literals they would give a first pass a kernel of its own."""
    return [dr.opaque(Float, 0, lanes) for _ in range(count)]


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
    run(job, pixel, first, dr.opaque(UInt32, end), dr.opaque(UInt32, groups), [], store)
    dr.eval(buffers)
    return buffers


def samples_in_parallel(pixels: int, count: int) -> int:
    """Lanes per pixel of a pass that stores its samples; they don't change the result."""
    lanes = 1
    while pixels * lanes < LANES and count % (2 * lanes) == 0 and count // (2 * lanes) >= 8:
        lanes *= 2
    return lanes
