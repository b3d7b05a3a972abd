"""Samples that belong to one pixel each although the film filters: their places are drawn by the filter's weight.

For an image the film shares samples: each counts for all pixels in reach. A table of derivatives would add each of them
to the rows of all these pixels, up to 25 with the default filter. Here a pixel p has samples of its own, at places x
about its middle with a density in proportion to abs(f(x - p)), which count for f / abs(f). Their mean has the
expectation of the film's weighted mean,

    integral of f(x - p) L(x) dx / integral of f(x - p) dx

over all places that have samples. The noise of neighbours is independent, so sums over pixels, which searches ask for,
are expected to be about as noisy as those of shared samples; that wasn't measured.

M. Ernst, M. Stamminger and G. Greiner, "Filter Importance Sampling", IEEE Symposium on Interactive Ray Tracing 2006.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import drjit as dr

from djpt.core.records import Ray3f
from djpt.jit.types import Float, Point2f, UInt32
from djpt.rendering.schedules.job import Job
from djpt.rfilters.base import ReconstructionFilter
from djpt.samplers import SampleStream

__all__ = ["FilteredJob", "own_samples"]

CELLS = 2**12
"""The number of cells in which a filter is integrated; pixels end between cells if its reach is a multiple of 0.5."""

QUANTILES = 2**13
"""The number of intervals of equal mass from which distances are drawn, with a constant density in each."""


def own_samples(job: Job) -> Job | None:
    """A job for the same image whose samples belong to one pixel each; None if rays depend on the pixel."""
    if not job.film.filters:
        return job
    if job.sensor.by_pixel:
        return None
    given = {f.name: getattr(job, f.name) for f in fields(Job) if f.init} | {"film": job.film.unfiltered()}
    return FilteredJob(**given, rfilter=job.film.rfilter(), bordered=job.film.sample_border())


class Distances:
    """The distribution of distances from a pixel's middle along an axis, in proportion to a filter's absolute value."""

    def __init__(self, rfilter: ReconstructionFilter) -> None:
        self._filter, self._reach = rfilter, rfilter.radius()
        self._width = 2 * self._reach / CELLS
        # Before the first cell there is nothing.
        node = dr.arange(UInt32, CELLS + 1)
        weight = dr.select(node == 0, 0, rfilter.eval((Float(node) - 0.5) * self._width - self._reach))
        dr.eval(weight)
        self._signed, self._mass = dr.cumsum(weight), dr.cumsum(dr.abs(weight))
        dr.eval(self._signed, self._mass)
        self._total = dr.gather(Float, self._mass, dr.opaque(UInt32, CELLS))
        self._quantiles = self._distances()

    def _distances(self) -> Float:
        """The distances below which 0, 1, .. `QUANTILES` equal parts of the mass lie."""
        wanted = Float(dr.arange(UInt32, QUANTILES + 1)) * (self._total / QUANTILES)
        low = dr.zeros(UInt32, QUANTILES + 1)
        for power in reversed(range(CELLS.bit_length() - 1)):
            middle = low + 2**power
            low = dr.select(dr.gather(Float, self._mass, middle) <= wanted, middle, low)
        before, after = (dr.gather(Float, self._mass, low + i) for i in (0, 1))
        within = dr.select(after > before, (wanted - before) / (after - before), 0)
        found = (Float(low) + dr.clip(within, 0, 1)) * self._width - self._reach
        dr.eval(found)
        return found

    def _at(self, sums: Float, distance: Float) -> Float:
        """Cumulative sums over cells, interpolated at a distance."""
        place = dr.clip((distance + self._reach) * (1 / self._width), 0, CELLS)
        cell = dr.minimum(UInt32(place), CELLS - 1)
        return dr.lerp(dr.gather(Float, sums, cell), dr.gather(Float, sums, cell + 1), place - Float(cell))

    def between(self, low: Float, high: Float, u: Float) -> Float:
        """A sample of the distribution between two distances, by a number u in [0, 1)."""
        first, last = self._at(self._mass, low), self._at(self._mass, high)
        place = dr.lerp(first, last, u) * (QUANTILES / self._total)
        number = dr.minimum(UInt32(place), QUANTILES - 1)
        below, above = (dr.gather(Float, self._quantiles, number + i) for i in (0, 1))
        return dr.clip(dr.lerp(below, above, place - Float(number)), low, high)

    def weight(self, low: Float, high: Float, distance: Float) -> Float:
        """The weight of a distance that was sampled between two: the filter's sign, scaled so that the mean is 1."""
        mass, signed = (self._at(sums, high) - self._at(sums, low) for sums in (self._mass, self._signed))
        found: Float = dr.select(self._filter.eval(distance) < 0, -mass, mass) / signed
        return found


@dataclass
class FilteredJob(Job):
    """A job whose samples are drawn about the middle of their pixel, in proportion to a filter; its film has none."""

    rfilter: ReconstructionFilter = field(kw_only=True)
    """The filter of the image."""
    bordered: bool = field(kw_only=True)
    """Whether there are samples outside of the crop window."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._distances = Distances(self.rfilter)
        self._sizes = [dr.opaque(Float, size) for size in (self.width, self.height)]

    def sampled_ray(self, stream: SampleStream, pixel: UInt32, x: Float, y: Float) -> tuple[Ray3f, Point2f]:
        u = stream.next_2d()
        offset = Point2f(*(self._distances.between(*self._ends(a, axis), u[axis]) for axis, a in enumerate((x, y))))
        place = (Point2f(x, y) + 0.5 + offset) * self._inverse_crop
        return self.ray_at(place, stream), offset + 0.5

    def weight(self, pixel: UInt32, k: UInt32) -> Float:
        """The weight of the sample k of each pixel, whose mean is 1; negative in lobes of the filter."""
        if not self.rfilter.has_lobes:
            return Float(1)
        u, result = self.stream(pixel, k).next_2d(), Float(1)
        for axis, a in enumerate(self.coordinates(pixel)):
            ends = self._ends(a, axis)
            result *= self._distances.weight(*ends, self._distances.between(*ends, u[axis]))
        return result

    def _ends(self, place: Float, axis: int) -> tuple[Float, Float]:
        """The least and the largest distance from the middle of a pixel along an axis at which there are samples."""
        reach = self.rfilter.radius()
        if self.bordered:
            return Float(-reach), Float(reach)
        return dr.maximum(-reach, -0.5 - place), dr.minimum(reach, self._sizes[axis] - 0.5 - place)
