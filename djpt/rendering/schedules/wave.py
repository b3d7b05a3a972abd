"""The wave schedule: a lane is a sample, or without a filter some samples of a pixel.

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
from djpt.rendering.schedules.flat import Flat
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import grouped, interleaved
from djpt.rendering.schedules.passes import stored_rows, summed_rows
from djpt.rendering.schedules.reconstruction import MAX_SUMS, Summed
from djpt.rendering.schedules.sinks import blank_sums

__all__ = ["Wave"]


class Wave(Flat):
    """One lane per sample, from its beginning to its end. Paths are replayed as in the flat schedule."""

    name = "wave"

    def rows(self, job: Job) -> Iterator[Summed]:
        # Without a filter a lane computes one sample of its pixel after the other, and adds them up.
        if job.film.filters or job.channel_count() > MAX_SUMS or not job.integrator.is_pure():
            return stored_rows(job, self.samples)
        return summed_rows(job, self._sums)

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

    def _values(self, job: Job, layer: UInt32, pixel: UInt32, begin: int) -> list[Float]:
        """The channels of the samples number `begin` + `layer` of pixels."""
        stream, ray, _ = job.begin(pixel, layer + dr.opaque(UInt32, begin), *job.coordinates(pixel))
        if job.integrator.is_pure():
            color, valid, aovs = job.integrator.sample(job.scene, stream, ray)
            return job.channels(color, valid, aovs)
        sampler = job.sampler.drawing(stream, dr.width(pixel))
        color, valid, aovs = job.integrator.sample(job.scene, sampler, ray, None, Bool(True))
        return job.channels(Color3f(color), Bool(valid), [Float(value) for value in aovs])
