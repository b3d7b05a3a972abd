"""Multi-jittered samples: one per cell of a grid, and one per row and column of a finer one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr

from djpt.description.registry import register_sampler
from djpt.jit.types import Bool, Float, Float64, Point2f, UInt32
from djpt.samplers.base import SampleIndex
from djpt.samplers.jittered import JitteredSampler, JitteredStream, below_one
from djpt.samplers.seeds import permute_kensler, quotient

__all__ = ["Multijitter", "MultijitterStream"]


@dataclass
class MultijitterStream(JitteredStream):
    """Columns x rows cells, of which each is divided again into rows x columns; `resolution` is the rows."""

    columns: UInt32

    def next_1d(self, active: Bool | bool = True) -> Float:
        seed = self.key + self.next_dimension()
        count = self.columns * self.resolution
        cell = permute_kensler(self.k, count, seed * 0x45FBE943)
        return below_one((Float(cell) + self.jitter(active)) * dr.rcp(Float(count)))

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        seed, columns, rows = self.key + self.next_dimension(), self.columns, self.resolution
        cell = permute_kensler(self.k, columns * rows, seed * 0x51633E2D)
        y = quotient(cell, columns)
        x = cell - y * columns
        # All cells of a column are shuffled alike: that is the correlation.
        across = permute_kensler(x, columns, seed * 0x68BC21EB)
        up = permute_kensler(y, rows, seed * 0x02E5BE93)
        per_column, per_row = dr.rcp(Float(columns)), dr.rcp(Float(rows))
        u = (Float(x) + (Float(up) + self.jitter(active)) * per_row) * per_column
        return Point2f(
            below_one(u), below_one((Float(y) + (Float(across) + self.jitter(active)) * per_column) * per_row)
        )


class Multijitter(JitteredSampler):
    """Correlated multi-jittered sampling: as `stratified`, and each coordinate alone is stratified finely as well.

    Parameters: `sample_count` (rounded up to r c with r = floor(sqrt(count)), r <= c <= r + 2; default 4), `seed`,
    `jitter` (a random position in the subcell, else its middle; default true).

    K. Chiu, P. Shirley and C. Wang, "Multi-Jittered Sampling", 1994; A. Kensler, "Correlated Multi-Jittered
    Sampling", Pixar Technical Memo 13-01, 2013. Numbers and pixels are Mitsuba's.
    """

    def round_count(self, spp: int) -> int:
        rows = math.isqrt(spp)
        return -(-spp // rows) * rows

    def stream(self, seed: UInt32, index: SampleIndex) -> MultijitterStream:
        samples = self.point_set(seed, index)
        rows = UInt32(dr.sqrt(Float64(index.spp)))
        columns = quotient(index.spp, rows)
        return MultijitterStream(self.generator(seed, index), samples.key, UInt32(0), samples.k, rows, columns)


register_sampler("multijitter", Multijitter)
