"""Which samples of which pixels the lanes of a kernel compute, one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from djpt.schedules.job import Band, Job
from djpt.types import UInt32

__all__ = ["Lanes", "grouped", "interleaved", "lanes_per_pixel", "layered", "tiled"]

BLOCK = 2**14
"""Lanes that one thread takes at a time: Dr.Jit's number."""

TILE = 4
"""Pixels of 4 x 4 tiles share a packet of lanes: their rays take similar ways."""

LANES = 2**16
"""Fewer lanes leave processor cores idle: Dr.Jit hands them out in blocks of 2^14."""


@dataclass
class Lanes:
    """A lane computes the samples first, first + stride, .. below `end` of its pixel."""

    pixel: UInt32
    first: UInt32
    end: UInt32
    stride: UInt32


def lanes_per_pixel(pixels: int, spp: int) -> int:
    """How many lanes share a pixel's samples: a power of two that depends on the image alone.

    A lane with many samples in a row evens out the lengths of its paths, so pixels are shared only
    where there are few of them.
    """
    lanes = 1
    while pixels * lanes < LANES and lanes < 64 and spp // (2 * lanes) >= 4:
        lanes *= 2
    return lanes


def samples_in_parallel(pixels: int, count: int) -> int:
    """Lanes per pixel of a pass that stores its samples; they don't change the result."""
    lanes = 1
    while pixels * lanes < LANES and count % (2 * lanes) == 0 and count // (2 * lanes) >= 8:
        lanes *= 2
    return lanes


def grouped(job: Job, band: Band, count: int) -> tuple[UInt32, UInt32]:
    """`count` lanes per pixel of a band, group by group: the number of the group, and the pixel."""
    pixels = band.rows * job.width
    index, size = dr.arange(UInt32, pixels * count), dr.opaque(UInt32, pixels)
    group = index // size
    return group, index - group * size + dr.opaque(UInt32, band.first_row * job.width)


def interleaved(job: Job, band: Band, begin: int, end: int) -> Lanes:
    """The samples begin <= k < end of a band, for sums that lanes carry from pass to pass.

    Lane g of a pixel owns the samples k = g modulo the number of its lanes, whatever the pass: so the
    order of additions doesn't depend on the passes.
    """
    count = lanes_per_pixel(job.width * job.height, job.spp)
    group, pixel = grouped(job, band, count)
    groups, start = dr.opaque(UInt32, count), dr.opaque(UInt32, begin)
    # The first k >= begin with k = group modulo `groups`, a power of two.
    first = start + ((group - start) & (groups - 1))
    return Lanes(pixel, first, dr.opaque(UInt32, end), groups)


def layered(job: Job, band: Band, begin: int, end: int) -> Lanes:
    """The samples begin <= k < end of a band, for storage as [k - begin][pixel]: see `sinks.Store`."""
    count = samples_in_parallel(band.rows * job.width, end - begin)
    group, pixel = grouped(job, band, count)
    return Lanes(pixel, dr.opaque(UInt32, begin) + group, dr.opaque(UInt32, end), dr.opaque(UInt32, count))


def tiled(job: Job, band: Band, begin: int, end: int) -> tuple[Lanes, UInt32, UInt32]:
    """The samples begin <= k < end of a band, for lanes of very different length.

    Also returns where each lane stores its first sample, for storage as [k - begin][pixel], and how
    far apart its samples lie. Packets of lanes are tiles of pixels. The blocks of lanes that threads
    take are spread evenly over the band, so that all take about the same time.
    """
    columns, rows = -(-job.width // TILE), -(-band.rows // TILE)
    tiles, size = columns * rows, TILE * TILE
    count = 1
    while tiles * size * count < 2 * LANES and (end - begin) // (2 * count) >= 4:
        count *= 2
    blocks = -(-tiles * size * count // BLOCK)
    lane = dr.arange(UInt32, blocks * BLOCK)
    packet, place = lane // size, lane % size
    block = packet // (BLOCK // size)
    # Neighbouring blocks take neighbouring tiles.
    packet = (packet - block * (BLOCK // size)) * dr.opaque(UInt32, blocks) + block
    group = packet // dr.opaque(UInt32, tiles)
    tile = packet - group * dr.opaque(UInt32, tiles)
    tile_row = tile // dr.opaque(UInt32, columns)
    column = (tile - tile_row * dr.opaque(UInt32, columns)) * TILE + place % TILE
    row = tile_row * TILE + place // TILE
    inside = (column < job.width_value) & (row < dr.opaque(UInt32, band.rows)) & (group < dr.opaque(UInt32, count))
    position = dr.fma(row, job.width_value, column)
    pixels, last = dr.opaque(UInt32, band.rows * job.width), dr.opaque(UInt32, end)
    first = dr.select(inside, dr.opaque(UInt32, begin) + group, last)
    pixel = position + dr.opaque(UInt32, band.first_row * job.width)
    lanes = Lanes(pixel, first, last, dr.opaque(UInt32, count))
    return lanes, dr.fma(group, pixels, position), pixels * dr.opaque(UInt32, count)
