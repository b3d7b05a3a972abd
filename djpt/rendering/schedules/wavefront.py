"""The wavefront schedule: for samplers that are nothing but a stream of lanes, such as those of scripts.

A lane is a sample, and the samples of a pixel follow each other, as such a sampler expects. Its numbers can't be asked
for again, or in another order: what the film needs of them is kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.jit.kernels import wide
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.passes import stored_rows
from djpt.rendering.schedules.reconstruction import Summed
from djpt.rendering.schedules.wave import Wave
from djpt.samplers import Sampler

__all__ = ["Wavefront", "WavefrontJob"]

LANES = 2**24
"""The largest number of lanes of a wavefront, if it has more than one sample per pixel."""


class WavefrontJob(Job):
    """A job whose samples are computed wavefront by wavefront.

    The wavefronts follow from the image alone, so that the numbers do, too: `pass_spp` has no effect.
    """

    splits_freely = False

    def __post_init__(self) -> None:
        super().__post_init__()
        counted = self.sampler.clone()
        counted.set_sample_count(self.spp)
        self.spp, self.pass_spp = counted.sample_count(), 0
        self.spp_value = dr.opaque(UInt32, self.spp)
        self._offsets: Point2f | None = None

    @property
    def pixels(self) -> int:
        """The number of pixels of the sampled grid."""
        return self.width * self.height

    @property
    def share(self) -> int:
        """The number of samples per pixel of a wavefront."""
        return max(n for n in range(1, self.spp + 1) if self.spp % n == 0 and (n == 1 or n * self.pixels <= LANES))

    def begun(self, share: int) -> Sampler:
        """The sampler of a first wavefront of `share` samples per pixel."""
        return self.sampler.begun(self.seed, self.spp, self.pixels, share)

    def rays(self, sampler: Sampler, first: int, share: int) -> Ray3f:
        """The camera rays of a wavefront: the samples from number `first` on."""
        pixel = dr.arange(UInt32, self.pixels * share) // dr.opaque(UInt32, share)
        ray, offset = self.sampled_ray(sampler, pixel, *self.coordinates(pixel))
        self._keep(offset, first, share)
        return ray

    def _keep(self, offset: Point2f, first: int, share: int) -> None:
        self._offsets = wide(offset, self.pixels * share)
        self._first, self._share = dr.opaque(UInt32, first), dr.opaque(UInt32, share)

    def film_offset(self, pixel: UInt32, k: UInt32) -> Point2f:
        """The film offset in [0, 1)^2 of a sample of the wavefront at hand: at first, of all samples."""
        if self._offsets is None:
            self._keep(self.begun(self.spp).next_2d(), 0, self.spp)
        return dr.gather(Point2f, self._offsets, dr.fma(pixel, self._share, k - self._first))

    def by_samples(self, values: list[Float]) -> list[Float]:
        """Values of the lanes of a wavefront in the order [k][pixel]."""
        lanes = self.pixels * (dr.width(self._offsets) // self.pixels)
        values = [wide(value, lanes) for value in values]
        dr.eval(values, self._offsets)
        slot, pixels = dr.arange(UInt32, lanes), dr.opaque(UInt32, self.pixels)
        k = slot // pixels
        lane = dr.fma(slot - k * pixels, self._share, k)
        return [dr.gather(Float, value, lane) for value in values]

    def by_lanes(self, values: list[Float]) -> list[Float]:
        """The opposite of `by_samples`."""
        lane, share = dr.arange(UInt32, dr.width(values[0])), dr.opaque(UInt32, dr.width(values[0]) // self.pixels)
        pixel = lane // share
        slot = dr.fma(lane - pixel * share, dr.opaque(UInt32, self.pixels), pixel)
        return [dr.gather(Float, value, slot) for value in values]


class Wavefront(Wave):
    """One lane per sample, the samples of a pixel side by side."""

    name = "wavefront"

    def rows(self, job: Job) -> Iterator[Summed]:
        assert isinstance(job, WavefrontJob)
        job = replace(job)  # which keeps numbers of its own
        sampler, share = job.begun(job.share), job.share

        def samples(job: Any, band: Band, begin: int, end: int) -> list[Float]:
            if begin:
                sampler.advance()
            return traced(job, sampler, begin, end - begin)

        return stored_rows(job, samples, job.pixels, share)

    def samples(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        """All samples of the image, which must be asked for at once."""
        assert isinstance(job, WavefrontJob) and (band, begin, end) == (Band(0, job.height), 0, job.spp)
        return traced(job, job.begun(job.spp), 0, job.spp)


def traced(job: WavefrontJob, sampler: Sampler, first: int, share: int) -> list[Float]:
    """The channels [k - first][pixel] of a wavefront."""
    ray = job.rays(sampler, first, share)
    color, valid, aovs = job.integrator.sample(job.scene, sampler, ray, None, Bool(True))
    sampler.schedule_state()
    return job.by_samples(job.channels(Color3f(color), Bool(valid), [Float(value) for value in aovs]))
