"""The wave schedule: a lane computes samples of a pixel one after the other, or a single one.

It runs any integrator with a method `sample`, and its code can be differentiated by plain AD.
Paths of different length leave lanes idle; `flat` is faster for integrators that advance
vertex by vertex.
"""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr

from djpt.jit.kernels import while_loop, wide
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.rendering.schedules.called_sums import CalledSums, Taps, usable
from djpt.rendering.schedules.flat import Flat, spread_called
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import grouped, interleaved
from djpt.rendering.schedules.passes import filtered_rows, stored_rows, summed_rows
from djpt.rendering.schedules.reconstruction import MAX_SUMS, Summed
from djpt.rendering.schedules.sinks import blank_sums

__all__ = ["Wave"]


class Wave(Flat):
    """One lane per sample, from its beginning to its end. Paths are replayed as in the flat schedule."""

    name = "wave"

    def rows(self, job: Job) -> Iterator[Summed]:
        # A lane computes one sample of its pixel after the other, and adds them up, if it can hold the sums.
        if job.integrator.is_pure():
            if not job.film.filters and job.channel_count() <= MAX_SUMS:
                return summed_rows(job, self._sums)
            if job.film.filters and usable(Taps(job.film.taps, job.channel_count()), job.film.rfilter()):
                return filtered_rows(job, self._film_sums, spread=spread_called)
        return stored_rows(job, self.samples)

    def samples(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        return self._values(job, *grouped(job, band, end - begin), begin)

    def _sums(self, job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
        lanes = interleaved(job, band, begin, end)
        if sums is None:
            sums = blank_sums(dr.width(lanes.pixel), job.channel_count())

        def body(k: UInt32, sums: list[Float]) -> tuple[UInt32, list[Float]]:
            values = self._values(job, k, lanes.pixel, 0)
            return k + lanes.stride, [total + value for total, value in zip(sums, values, strict=True)]

        start = wide(lanes.first, dr.width(lanes.pixel))
        _, result = while_loop((start, sums), lambda k, sums: k < lanes.end, body, label="wave")
        with small_blocks():
            dr.eval(result)
        return result

    def _film_sums(self, job: Job, band: Band, begin: int, end: int, memory: list[Float] | None) -> list[Float]:
        lanes = interleaved(job, band, begin, end)
        x, y = job.coordinates(lanes.pixel)
        taps, width = Taps(job.film.taps, job.channel_count()), dr.width(lanes.pixel)
        sums = CalledSums(taps, job.film.rfilter(), width, None if memory is None else memory[0])
        corner = job.on_film(x, y)

        def body(k: UInt32, count: UInt32) -> tuple[UInt32, UInt32]:
            stream, ray, offset = job.begin(lanes.pixel, k, x, y)
            color, valid, aovs = job.integrator.sample(job.scene, stream, ray)
            taken = sums.add(corner, offset, job.channels(color, valid, aovs), k < lanes.end)
            return k + lanes.stride, count + dr.select(taken, UInt32(1), 0)

        start = wide(lanes.first, width), dr.zeros(UInt32, width)
        _, count = while_loop(start, lambda k, count: k < lanes.end, body, label="wave")
        with small_blocks():
            dr.eval(count)
        return [sums.memory]

    def _values(self, job: Job, layer: UInt32, pixel: UInt32, begin: int) -> list[Float]:
        """The channels of the samples number `begin` + `layer` of pixels."""
        stream, ray, _ = job.begin(pixel, layer + dr.opaque(UInt32, begin), *job.coordinates(pixel))
        if job.integrator.is_pure():
            color, valid, aovs = job.integrator.sample(job.scene, stream, ray)
            return job.channels(color, valid, aovs)
        sampler = job.sampler.drawing(stream, dr.width(pixel))
        color, valid, aovs = job.integrator.sample(job.scene, sampler, ray, None, Bool(True))
        return job.channels(Color3f(color), Bool(valid), [Float(value) for value in aovs])
