"""Lanes: which samples each lane computes, and in which order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.jit.types import Bool, Float, Int32, UInt32
from djpt.rendering.schedules.job import Band, Job

__all__ = [
    "Lanes",
    "TiledLanes",
    "TiledSample",
    "grouped",
    "interleaved",
    "lanes_per_pixel",
    "layered",
    "one_by_one",
]

BLOCK = 2**14
"""The number of lanes that one thread of Dr.Jit takes at a time."""

TILE = 4
"""Width and height of the tiles whose pixels share a packet of lanes: their rays take similar ways."""

PACKET = TILE * TILE

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
    """The number of lanes that share a pixel's samples: a power of two that depends on the image alone.

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


def side_by_side(job: Job, band: Band, count: int) -> tuple[UInt32, UInt32]:
    """`count` lanes per pixel of a band, pixel by pixel: the number of the lane in its pixel, and the pixel.

    The lanes of a packet then have few pixels: in small images those of a row see different things.
    """
    index, size = dr.arange(UInt32, band.rows * job.width * count), dr.opaque(UInt32, count)
    pixel = index // size
    return index - pixel * size, pixel + dr.opaque(UInt32, band.first_row * job.width)


def interleaved(job: Job, band: Band, begin: int, end: int) -> Lanes:
    """The samples begin <= k < end of a band, for sums that lanes carry from pass to pass; `side_by_side`.

    Lane g of a pixel owns the samples k = g modulo the number of its lanes, whatever the pass: so the
    order of additions doesn't depend on the passes.
    """
    count = lanes_per_pixel(job.width * job.height, job.spp)
    group, pixel = side_by_side(job, band, count)
    groups, start = dr.opaque(UInt32, count), dr.opaque(UInt32, begin)
    # The first k >= begin with k = group modulo `groups`, a power of two.
    first = start + ((group - start) & (groups - 1))
    return Lanes(pixel, first, dr.opaque(UInt32, end), groups)


def one_by_one(job: Job, band: Band, begin: int, end: int) -> Lanes:
    """The samples begin <= k < end of a band, one lane per pixel."""
    _, pixel = side_by_side(job, band, 1)
    return Lanes(pixel, dr.opaque(UInt32, begin), dr.opaque(UInt32, end), dr.opaque(UInt32, 1))


def layered(job: Job, band: Band, begin: int, end: int) -> Lanes:
    """The samples begin <= k < end of a band, for storage as [k - begin][pixel]: see `sinks.Store`."""
    count = samples_in_parallel(band.rows * job.width, end - begin)
    group, pixel = grouped(job, band, count)
    return Lanes(pixel, dr.opaque(UInt32, begin) + group, dr.opaque(UInt32, end), dr.opaque(UInt32, count))


class TiledLanes:
    """Lanes that compute the samples begin <= k < end of a band, for the machine schedule.

    A packet of lanes (16, whatever the processor's) covers a tile of pixels, whose rays take similar
    ways. It has a list of samples to do, and a lane that has finished one takes the next from the list,
    so that none runs out of work before the others. The blocks of packets that threads take are spread
    evenly over the band, for the same reason. Samples are stored as [k - begin][pixel].
    """

    def __init__(self, job: Job, band: Band, begin: int, end: int) -> None:
        columns, rows = -(-job.width // TILE), -(-band.rows // TILE)
        tiles = columns * rows
        share = 1
        while tiles * PACKET * share < LANES and (end - begin) // (2 * share) >= 4:
            share *= 2
        blocks = -(-tiles * PACKET * share // BLOCK)
        self.count = blocks * BLOCK
        packets = self.count // PACKET

        lane = dr.arange(UInt32, self.count)
        self._packet = lane // PACKET
        block = self._packet // (BLOCK // PACKET)
        # Neighbouring blocks take neighbouring tiles.
        spread = (self._packet - block * (BLOCK // PACKET)) * dr.opaque(UInt32, blocks) + block
        # Tiles are shared by `share` packets: the layers.
        layer = spread // dr.opaque(UInt32, tiles)
        tile = spread - layer * dr.opaque(UInt32, tiles)
        row = tile // dr.opaque(UInt32, columns)
        self._column, self._row = (tile - row * dr.opaque(UInt32, columns)) * TILE, row * TILE
        self._share, self._begin, self._end = (dr.opaque(UInt32, n) for n in (share, begin, end))
        self._first_k = dr.select(layer < self._share, self._begin + layer, self._end)
        self._width, self._rows = job.width_value, dr.opaque(UInt32, band.rows)
        self._first_pixel = dr.opaque(UInt32, band.first_row * job.width)
        self._first_row = dr.opaque(UInt32, band.first_row)
        self._pixels = dr.opaque(UInt32, band.rows * job.width)
        self.first = lane % PACKET
        """The first entry of each lane in its packet's list."""
        self._taken = dr.opaque(UInt32, PACKET, packets)

    def next(self, entry: UInt32, finished: Bool) -> UInt32:
        """The entry that a lane does next: where it has `finished`, the first free one of its packet's list."""
        # The lanes of a packet run in step, on one thread, so each always gets the same entries.
        taken: Any = dr.scatter_inc(self._taken, self._packet, finished)
        result: UInt32 = dr.select(finished, taken, entry)
        return result

    def at(self, entry: UInt32) -> TiledSample:
        """The sample at an entry of a packet's list."""
        place, k = entry % PACKET, dr.fma(entry // PACKET, self._share, self._first_k)
        column, row = self._column + place % TILE, self._row + place // TILE
        position = dr.fma(row, self._width, column)
        return TiledSample(
            pixel=position + self._first_pixel,
            k=k,
            x=Float(Int32(column)),
            y=Float(Int32(row + self._first_row)),
            slot=dr.fma(k - self._begin, self._pixels, position),
            left=k < self._end,
            # Tiles may stick out of the band on the right and below.
            exists=(column < self._width) & (row < self._rows),
        )

    def left(self, entry: UInt32) -> Bool:
        """True where a packet's list has the entry; False where a lane has nothing left to do."""
        return dr.fma(entry // PACKET, self._share, self._first_k) < self._end


@dataclass
class TiledSample:
    """The sample that a lane computes."""

    pixel: UInt32
    k: UInt32
    x: Float
    """The column on the grid; `y` is the row."""
    y: Float
    slot: UInt32
    left: Bool
    """True where the entry exists: see `TiledLanes.left`."""
    exists: Bool
    """True where the pixel is within the band; else the result must not be stored."""
