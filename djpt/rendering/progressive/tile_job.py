"""Jobs of some tiles of an image: their samples, and the sums of their films.

The tiles stand one above the other on a grid of their own, which schedules fill as they fill any grid. What a sample
is, its random numbers and its camera ray, follows from its pixel on the image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.jit.kernels import while_loop
from djpt.jit.types import Float, Int32, Point2f, UInt32
from djpt.rendering.progressive.tiles import Tiles
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.called_sums import reader, usable
from djpt.rendering.schedules.film_accumulation import Taps
from djpt.rendering.schedules.flat import Flat, called_film_sums
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.passes import computed, one_ahead
from djpt.rendering.schedules.reconstruction import MAX_SUMS, Read, add_by_pixels
from djpt.rfilters.base import is_wide
from djpt.samplers import SampleIndex, SampleStream

__all__ = ["TileJob", "film_sums", "reason_against"]

STORED_SAMPLES = 2**22
"""Samples whose values are held at once."""


@dataclass
class TileJob(Job):
    """Some tiles of an image. A tile may be there several times, with different seeds."""

    tiles: Tiles = field(kw_only=True)
    places: UInt32 = field(kw_only=True)
    """The number of each of the tiles."""
    seeds: UInt32 = field(kw_only=True)
    """The seed of each."""

    @staticmethod
    def of(job: Job, tiles: Tiles, places: UInt32, seeds: UInt32) -> TileJob:
        """The job of some tiles of a job's image."""
        given = {f.name: getattr(job, f.name) for f in fields(Job) if f.init}
        own = seeds + dr.opaque(UInt32, job.sampler.base_seed)
        dr.eval(own)
        return TileJob(**given, tiles=tiles, places=places, seeds=own)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._row_size = self.width_value
        self._last = [dr.opaque(UInt32, n - 1) for n in self.tiles.grid]
        self._columns = dr.opaque(UInt32, self.tiles.columns)
        self._height = dr.opaque(UInt32, self.tiles.height)
        self.width, self.height = self.tiles.width, self.tiles.height * dr.width(self.places)
        self.width_value = dr.opaque(UInt32, self.width)
        self._found: Any = (None,)

    def corner(self, entry: UInt32) -> tuple[UInt32, UInt32]:
        """The first column and row of an entry's tile on the image's grid."""
        tile = dr.gather(UInt32, self.places, entry)
        row = tile // self._columns
        return (tile - row * self._columns) * self.width_value, row * self._height

    def _place(self, pixel: UInt32) -> tuple[UInt32, UInt32, UInt32, UInt32]:
        """Column and row on the image's grid, pixel there, seed.

        Loops ask for each sample of lanes that stay at a pixel: what was computed before the loop isn't computed again.
        """
        if self._found[0] is not pixel:
            row = pixel // self.width_value
            entry = row // self._height
            left, top = self.corner(entry)
            # Tiles may reach beyond the grid, where nothing is kept.
            x = dr.minimum(left + pixel - row * self.width_value, self._last[0])
            y = dr.minimum(top + row - entry * self._height, self._last[1])
            found = x, y, dr.fma(y, self._row_size, x), dr.gather(UInt32, self.seeds, entry)
            if dr.flag(dr.JitFlag.SymbolicScope):
                return found
            self._found = pixel, *found
        return self._found[1:]

    def stream(self, pixel: UInt32, k: UInt32) -> SampleStream:
        _, _, real, seed = self._place(pixel)
        return self.sampler.stream(seed, SampleIndex(real, k, self.spp_value, self._row_size))

    def coordinates(self, pixel: UInt32) -> tuple[Float, Float]:
        x, y, _, _ = self._place(pixel)
        return Float(Int32(x)), Float(Int32(y))

    def sampled_ray(self, stream: SampleStream, pixel: UInt32, x: Float, y: Float) -> tuple[Ray3f, Point2f]:
        return super().sampled_ray(stream, self._place(pixel)[2], x, y)


def reason_against(job: Job, schedule: Schedule) -> str:
    """What keeps an image from being rendered in tiles; an empty text if nothing does."""
    if not isinstance(schedule, Flat):
        return f"the schedule '{schedule.name}' makes an image as a whole"
    if not job.channel_names():
        return "no channel is sampled"
    if is_wide(job.film.taps):
        return f"the film's filter reaches {job.film.taps // 2} pixels"
    return ""


def film_sums(job: TileJob, schedule: Schedule) -> list[Float]:
    """The sums of the tiles' films by channel, the weight being the last one with a filter: [entry][row][column]."""
    if not job.film.filters:
        parts = [rows.sums for rows, _ in schedule.rows(job)]
        return parts[0] if len(parts) == 1 else [dr.concat(list(channel)) for channel in zip(*parts, strict=True)]
    channels = job.channel_count()
    high, wide = job.tiles.film
    lanes = dr.width(job.places) * high * wide
    sums = [dr.opaque(Float, 0, lanes) for _ in range(channels + 1)]
    band, taps = Band(0, job.height), Taps(job.film.taps, channels)
    if type(schedule) is Flat and usable(taps, job.film.rfilter()):
        memory = called_film_sums(job, band, 0, job.spp, None)[0]
        groups = dr.width(memory) // (taps.sums * job.width * job.height)
        return spread(job, groups, lambda row: reader(memory, taps, row), sums)
    # As many channels at once as have sums near the registers.
    together = max(1, MAX_SUMS // taps.count**2 - 1)
    of_taps: list[list[Float]] = []
    for begin, end in passes(job):
        samples = computed(schedule.samples, job, band, begin, end)
        parts = [samples[first : first + together] for first in range(0, channels, together)]
        before = of_taps or [None] * len(parts)  # type: ignore[list-item]
        of_taps = [add_by_pixels(job, band, part, begin, end, b) for part, b in zip(parts, before, strict=True)]
    found: list[Float] = []
    for part in of_taps:
        count = len(part) // taps.count**2
        found = found[:-1] + spread(job, 1, lambda row, part=part: stored(part, taps.count, row), sums[:count])
    return found


def passes(job: TileJob) -> Iterator[tuple[int, int]]:
    """The passes (begin, end) of a job whose samples are stored."""
    size = max(1, STORED_SAMPLES // (job.width * job.height))
    for begin in one_ahead(range(0, job.spp, size)):
        yield begin, min(begin + size, job.spp)


def stored(sums: list[Float], taps: int, row: int) -> Read:
    """Reads the sums of pixels for a row tap: see `djpt.rendering.schedules.reconstruction.add_by_pixels`."""
    channels = len(sums) // taps**2

    def tap(lane: UInt32, column: int, active: Any) -> list[Float]:
        first = (row * taps + column) * channels
        return [dr.gather(Float, sums[first + c], lane, active) for c in range(channels)]

    return tap


def spread(job: TileJob, groups: int, read: Any, sums: list[Float]) -> list[Float]:
    """Add to the pixels of the tiles' films what the `groups` of lanes of the tiles' pixels hold for them."""
    tiles, taps = job.tiles, job.film.taps
    high, wide = (dr.opaque(UInt32, n) for n in tiles.film)
    index = dr.arange(UInt32, dr.width(sums[0]))
    row = index // wide
    entry = row // high
    column, line = Int32(index - row * wide), Int32(row - entry * high)
    left, top = job.corner(entry)
    # What lies beyond the grid has been sampled for nothing.
    columns = dr.minimum(Int32(job.width_value), Int32(job._last[0] + 1 - left))
    rows = dr.minimum(Int32(job._height), Int32(job._last[1] + 1 - top))
    width, first = Int32(job.width_value), Int32(entry * job._height)
    size, end = dr.opaque(UInt32, job.width * job.height), dr.opaque(UInt32, groups * job.width * job.height)
    for j in range(taps):
        tap, y = read(j), line - dr.opaque(Int32, j)

        def body(start: UInt32, sums: list[Float], tap: Read = tap, y: Int32 = y) -> tuple[UInt32, list[Float]]:
            result = list(sums)
            for i in range(taps):
                x = column - i
                inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
                parts = tap(start + UInt32((first + y) * width + x), i, inside)
                result = [total + part for total, part in zip(result, parts, strict=True)]
            return start + size, result

        start = dr.zeros(UInt32, dr.width(index))
        _, sums = while_loop((start, sums), lambda start, sums: start < end, body, label="tile spread")
    dr.eval(sums)
    return sums
