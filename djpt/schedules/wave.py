"""The wave schedule: a lane is a sample.

It runs any integrator, `sample` being all that it asks for, and its code can be
differentiated by plain AD. Paths of different length leave lanes idle; `flat` is faster
for integrators that advance vertex by vertex.
"""

from __future__ import annotations

import drjit as dr

from djpt.schedules.job import Band, Job
from djpt.types import Float, UInt32

__all__ = ["LANES", "radiance_samples"]

LANES = 2**21
"""Lanes of one pass: bounds the memory that per-sample results take."""


def radiance_samples(job: Job, band: Band, begin: int, end: int) -> list[Float]:
    """The samples begin <= k < end of a band's pixels: per channel an array [k - begin][pixel]."""
    pixels = band.rows * job.width
    lane = dr.arange(UInt32, pixels * (end - begin))
    size = dr.opaque(UInt32, pixels)
    layer = lane // size
    pixel = lane - layer * size + dr.opaque(UInt32, band.first_row * job.width)
    stream, ray, _ = job.begin(pixel, layer + dr.opaque(UInt32, begin), *job.coordinates(pixel))
    color, valid, aovs = job.integrator.sample(job.scene, stream, ray)
    return job.channels(color, valid, aovs)
