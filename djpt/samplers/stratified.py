"""Samples from the cells of a square grid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr

from djpt.description.registry import register_sampler
from djpt.jit.types import Bool, Float, Float64, Point2f, UInt32
from djpt.samplers.base import SampleIndex
from djpt.samplers.jittered import JitteredSampler, JitteredStream, below_one
from djpt.samplers.seeds import permute_kensler, quotient

__all__ = ["Stratified", "StratifiedStream"]


@dataclass
class StratifiedStream(JitteredStream):
    """n x n cells for pairs of numbers, n^2 intervals for single ones."""

    def permuted(self, count: UInt32) -> UInt32:
        """The sample's cell in the next dimension."""
        return permute_kensler(self.k, count, self.key + self.next_dimension())

    def next_1d(self, active: Bool | bool = True) -> Float:
        count = self.resolution * self.resolution
        cell = Float(self.permuted(count))
        return below_one((cell + self.jitter(active)) * dr.rcp(Float(count)))

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        n = self.resolution
        cell = self.permuted(n * n)
        y = quotient(cell, n)
        scale = dr.rcp(Float(n))
        u = below_one((Float(cell - y * n) + self.jitter(active)) * scale)
        return Point2f(u, below_one((Float(y) + self.jitter(active)) * scale))


class Stratified(JitteredSampler):
    """One sample in each cell of an n x n grid, the cells in random order in every dimension.

    Parameters: `sample_count` (rounded up to a square n^2, default 4), `seed`, `jitter` (a random position in
    the cell, else its middle; default true). Single numbers come from n^2 intervals.

    The variance between cells vanishes, the variance within cells remains. Numbers and pixels are Mitsuba's.
    """

    def round_count(self, spp: int) -> int:
        return (math.isqrt(spp - 1) + 1) ** 2

    def stream(self, seed: UInt32, index: SampleIndex) -> StratifiedStream:
        samples = self.point_set(seed, index)
        n = UInt32(dr.sqrt(Float64(index.spp)))
        return StratifiedStream(self.generator(seed, index), samples.key, UInt32(0), samples.k, n)


register_sampler("stratified", Stratified)
