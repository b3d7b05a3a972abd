"""Orthogonal arrays: stratified in every pair of dimensions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import drjit as dr

from djpt.description.properties import Properties
from djpt.description.registry import register_sampler
from djpt.jit.types import Bool, Float, Float64, Point2f, UInt32
from djpt.samplers.base import SampleIndex
from djpt.samplers.jittered import JitteredSampler, JitteredStream, below_one
from djpt.samplers.seeds import permute_kensler, quotient, remainder

__all__ = ["Orthogonal", "OrthogonalStream"]


@dataclass
class OrthogonalStream(JitteredStream):
    """Bose's array of strength 2 with n levels, n prime: row a n + b is a + (j - 1) b modulo n in dimension j."""

    def next_1d(self, active: Bool | bool = True) -> Float:
        n, j = self.resolution, self.next_dimension()
        row = permute_kensler(self.k, n * n, self.key)
        a = quotient(row, n)
        b = row - a * n
        # Dimensions are paired: a sample's cell in the other dimension is its subcell in this one.
        partner = dr.select((j & 1) == 1, j - 1, j + 1)
        first, second = j == 0, j == 1
        cell = dr.select(first, a, dr.select(second, b, remainder(a + (j - 1) * b, n)))
        subcell = dr.select(first, b, dr.select(second, a, remainder(a + (partner - 1) * b, n)))
        return self.place(j, cell, subcell, n, active)

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        x = self.next_1d(active)
        return Point2f(x, self.next_1d(active))

    def place(self, j: UInt32, cell: UInt32, subcell: UInt32, subcells: UInt32, active: Bool | bool) -> Float:
        """The coordinate of a sample, cells and subcells shuffled."""
        n, seed = self.resolution, self.key * (j + 1)
        cell = permute_kensler(cell, n, seed * 0x51633E2D)
        subcell = permute_kensler(subcell, subcells, seed * 0x68BC21EB)
        offset = (Float(subcell) + self.jitter(active)) * dr.rcp(Float(subcells))
        return below_one((Float(cell) + offset) * dr.rcp(Float(n)))


@cache
def bush_stream(strength: int) -> type[OrthogonalStream]:
    """The streams of Bush's arrays: dimension j is a polynomial of the row's digits at j, modulo n."""

    @dataclass
    class BushStream(OrthogonalStream):
        def next_1d(self, active: Bool | bool = True) -> Float:
            n, j = self.resolution, self.next_dimension()
            rows = n
            for _ in range(strength - 1):
                rows = rows * n
            row = permute_kensler(self.k, rows, self.key)
            # Mitsuba's lowest digit isn't reduced modulo n; and so its arrays are not of the strength asked for.
            upper = quotient(row, n)
            digits, rest = [row - row * n], row
            for _ in range(strength - 1):
                digits.append(remainder(rest, n))
                rest = quotient(rest, n)
            value = UInt32(0)
            for digit in reversed(digits):
                value = value * j + digit
            subcells = quotient(rows, n)
            return self.place(j, remainder(value, n), remainder(upper, subcells), subcells, active)

    return BushStream


class Orthogonal(JitteredSampler):
    """Orthogonal arrays: n x n cells for every pair of a sample's numbers, not only for those drawn together.

    Parameters: `sample_count` (rounded up to the square of a prime n, default 4), `seed`, `jitter` (a random
    position in the subcell, else its middle; default true), `strength` (2 to 6, default 2; Mitsuba's numbers for
    others have no such structure).

    W. Jarosz, A. Enayet, A. Kensler, C. Kilpatrick and P. Christensen, "Orthogonal Array Sampling for Monte Carlo
    Rendering", 2019; R. Bose 1938, K. Bush 1952. Numbers and pixels are Mitsuba's. More than n + 1 dimensions
    repeat cells.
    """

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.strength = props.integer("strength", 2, low=2, high=6)

    def round_count(self, spp: int) -> int:
        n = max(2, math.isqrt(spp - 1) + 1)
        while any(n % d == 0 for d in range(2, math.isqrt(n) + 1)):
            n += 1
        return n * n

    def stream(self, seed: UInt32, index: SampleIndex) -> OrthogonalStream:
        samples = self.point_set(seed, index)
        n = UInt32(dr.sqrt(Float64(index.spp)))
        made = OrthogonalStream if self.strength == 2 else bush_stream(self.strength)
        return made(self.generator(seed, index), samples.key, UInt32(0), samples.k, n)


register_sampler("orthogonal", Orthogonal)
