"""The wave schedule: a lane is a sample.

It runs any integrator with a method `sample`, and its code can be differentiated by plain AD.
Paths of different length leave lanes idle; `flat` is faster for integrators that advance
vertex by vertex.
"""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr

from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.rendering.schedules.flat import Flat
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.lanes import grouped
from djpt.rendering.schedules.passes import stored_rows
from djpt.rendering.schedules.reconstruction import Summed

__all__ = ["Wave"]


class Wave(Flat):
    """One lane per sample. Paths are replayed as in the flat schedule."""

    name = "wave"

    def rows(self, job: Job) -> Iterator[Summed]:
        return stored_rows(job, self.samples)

    def samples(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        layer, pixel = grouped(job, band, end - begin)
        stream, ray, _ = job.begin(pixel, layer + dr.opaque(UInt32, begin), *job.coordinates(pixel))
        if job.integrator.is_pure():
            color, valid, aovs = job.integrator.sample(job.scene, stream, ray)
            return job.channels(color, valid, aovs)
        sampler = job.sampler.drawing(stream, dr.width(pixel))
        color, valid, aovs = job.integrator.sample(job.scene, sampler, ray, None, Bool(True))
        return job.channels(Color3f(color), Bool(valid), [Float(value) for value in aovs])
