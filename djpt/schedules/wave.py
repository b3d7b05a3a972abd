"""The wave schedule: a lane is a sample.

It runs any integrator, `sample` being all that it asks for, and its code can be
differentiated by plain AD. Paths of different length leave lanes idle; `flat` is faster
for integrators that advance vertex by vertex.
"""

from __future__ import annotations

import drjit as dr

from djpt.schedules.job import Band, Job
from djpt.schedules.lanes import grouped
from djpt.types import Float, UInt32

__all__ = ["radiance_samples"]


def radiance_samples(job: Job, band: Band, begin: int, end: int) -> list[Float]:
    """The samples begin <= k < end of a band's pixels: per channel an array [k - begin][pixel]."""
    layer, pixel = grouped(job, band, end - begin)
    stream, ray, _ = job.begin(pixel, layer + dr.opaque(UInt32, begin), *job.coordinates(pixel))
    color, valid, aovs = job.integrator.sample(job.scene, stream, ray)
    return job.channels(color, valid, aovs)
