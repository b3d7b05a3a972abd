"""Lanes that compute several pixels, one after the other: for rounds of few samples.

The lanes of a packet end together, when the longest of their sums of paths has ended. With 64 samples per lane that is
4 % of the time, with 256 it is 1 %. The samples are added up in memory, pixel by pixel in the order of plain images,
so the sums have the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Array3f, Float, Point2f, UInt32
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.called_sums import CalledSums, prepare_function, usable
from djpt.rendering.schedules.film_accumulation import Taps
from djpt.rendering.schedules.flat import Flat, run, spread_called
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import Lanes, lanes_per_pixel
from djpt.rendering.schedules.passes import filtered_rows
from djpt.rendering.schedules.reconstruction import Summed
from djpt.rendering.schedules.sinks import CalledFilmSums, Finished
from djpt.samplers import SampleStream

__all__ = ["MultiPixelJob", "multi_pixel_rows", "pixels_per_lane"]

LONGEST = 8
"""The most pixels of a lane."""

LANES = 2**13
"""The lanes that each thread has at least."""


def pixels_per_lane(job: Job, schedule: Schedule) -> int:
    """The number of pixels that a lane computes; 1 if lanes can't have several.

    Without a filter sums stay in registers, and lanes at their pixels: sums in memory would take longer. Ask before
    kernels are recorded: the function that adds samples to films is compiled.
    """
    taps = Taps(job.film.taps, job.channel_count())
    pixels, count = job.width * job.height, 1
    if type(schedule) is not Flat or not job.film.filters or not usable(taps, job.film.rfilter()):
        return 1
    if lanes_per_pixel(pixels, job.spp) > 1:
        return 1
    while count < LONGEST and job.height % (2 * count) == 0 and pixels // (2 * count) >= LANES * dr.thread_count():
        count *= 2
    if count > 1:
        prepare_function(taps, job.film.rfilter())
    return count


@dataclass
class MultiPixelJob(Job):
    """A job whose samples are numbered over the pixels of a lane: `height / pixels_per_lane` rows apart."""

    pixels_per_lane: int = field(kw_only=True)
    """The pixels of a lane."""

    @staticmethod
    def of(job: Job, pixels_per_lane: int) -> MultiPixelJob:
        """A job with lanes of so many pixels."""
        return MultiPixelJob(
            **{f.name: getattr(job, f.name) for f in fields(Job) if f.init}, pixels_per_lane=pixels_per_lane
        )

    def __post_init__(self) -> None:
        super().__post_init__()
        rows = self.height // self.pixels_per_lane
        self.step = dr.opaque(UInt32, rows * self.width)
        self._rows, self._share = dr.opaque(Float, rows), dr.opaque(Float, 1 / self.spp)

    def begin(self, pixel: UInt32, k: UInt32, x: Float, y: Float) -> tuple[SampleStream, Ray3f, Any]:
        """As in `Job`; the third number of the offset is the index of the pixel within the lane."""
        turn = dr.floor((Float(k) + 0.5) * self._share)
        number = UInt32(turn)
        real = dr.fma(number, self.step, pixel)
        stream = self.stream(real, k - number * self.spp_value)
        ray, offset = self.sampled_ray(stream, real, x, self.row(y, turn))
        return stream, ray, Array3f(offset.x, offset.y, turn)

    def row(self, y: Float, turn: Float) -> Float:
        """The row of a pixel of a lane whose first one is in row `y`."""
        return dr.fma(turn, self._rows, y)


class MultiPixelSums(CalledFilmSums):
    """Adds the samples of lanes to the sums of their pixels."""

    def __init__(self, job: MultiPixelJob, pixel: UInt32, sums: CalledSums, steps: int) -> None:
        x, y = job.coordinates(pixel)
        super().__init__(job.on_film(x, y), sums, steps)
        self._job, self._pixel, self._x, self._y = job, pixel, x, y

    def close(self, state: list[Any], waiting: Finished | None) -> list[Any]:
        assert waiting is not None
        place: Any = waiting.offset
        corner = self._job.on_film(self._x, self._job.row(self._y, place.z))
        slot = dr.fma(UInt32(place.z), self._job.step, self._pixel)
        taken = self._sums.add(corner, Point2f(place.x, place.y), waiting.channels, waiting.full, slot)
        return [state[0] + dr.select(taken, UInt32(1), 0)]


def multi_pixel_rows(job: MultiPixelJob) -> Iterator[Summed]:
    """The sums of a job's image in one band: see `djpt.rendering.schedules.base.Schedule.rows`."""
    return filtered_rows(job, multi_pixel_sums, spread=spread_called)


def multi_pixel_sums(job: Job, band: Band, begin: int, end: int, memory: list[Float] | None) -> list[Float]:
    """The film's sums of all samples of a job."""
    assert isinstance(job, MultiPixelJob)
    pixels = job.width * job.height
    taps = Taps(job.film.taps, job.channel_count())
    pixel = dr.arange(UInt32, pixels // job.pixels_per_lane)
    lanes = Lanes(pixel, dr.opaque(UInt32, 0), dr.opaque(UInt32, job.pixels_per_lane * job.spp), dr.opaque(UInt32, 1))
    sums = CalledSums(taps, job.film.rfilter(), pixels)
    # See `djpt.rendering.schedules.flat.called_film_sums`.
    steps = 2 if job.scene.geometry.triangles is None else 1
    count = run(job, lanes, MultiPixelSums(job, pixel, sums, steps))
    with small_blocks():
        dr.eval(count)
    return [sums.memory]
