"""The wave schedule: a lane is a sample.

It runs any integrator with a method `sample`, and its code can be differentiated by plain AD.
Paths of different length leave lanes idle; `flat` is faster for integrators that advance
vertex by vertex.
"""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr

from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.rendering.schedules.canvas import Summed
from djpt.rendering.schedules.flat import Flat
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import LANES, grouped, side_by_side
from djpt.rendering.schedules.passes import stored_pixels, stored_rows, stored_spp, unfiltered_rows
from djpt.rendering.schedules.reconstruction import add_box

__all__ = ["Wave"]


class Wave(Flat):
    """One lane per sample. Paths are replayed as in the flat schedule."""

    name = "wave"

    def rows(self, job: Job) -> Iterator[Summed]:
        # In a small image the pixels of a row see different things, as the samples of one pixel don't.
        if job.film.filters or job.width * job.height >= LANES or not job.integrator.is_pure():
            return stored_rows(job, self.samples)
        return unfiltered_rows(job, self._add_box, stored_pixels(job), stored_spp(job))

    def samples(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        return self._values(job, *grouped(job, band, end - begin), begin)

    def _add_box(self, job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
        values = self._values(job, *side_by_side(job, band, end - begin), begin)
        with small_blocks():
            dr.eval(values)
        return add_box(job, band, values, begin, end, sums, side_by_side=True)

    def _values(self, job: Job, layer: UInt32, pixel: UInt32, begin: int) -> list[Float]:
        """The channels of the samples number `begin` + `layer` of pixels."""
        stream, ray, _ = job.begin(pixel, layer + dr.opaque(UInt32, begin), *job.coordinates(pixel))
        if job.integrator.is_pure():
            color, valid, aovs = job.integrator.sample(job.scene, stream, ray)
            return job.channels(color, valid, aovs)
        sampler = job.sampler.drawing(stream, dr.width(pixel))
        color, valid, aovs = job.integrator.sample(job.scene, sampler, ray, None, Bool(True))
        return job.channels(Color3f(color), Bool(valid), [Float(value) for value in aovs])
