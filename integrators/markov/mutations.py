"""The random numbers of a Markov chain's sample, and those of its proposals.

C. Kelemen, L. Szirmay-Kalos, G. Antal and F. Csonka, "A Simple and Robust Mutation Strategy for the Metropolis Light
Transport Algorithm", 2002.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.jit.kernels import minimum
from djpt.jit.types import Bool, Float, Point2f, UInt32
from djpt.samplers.independent import IndependentStream

__all__ = ["Mutated", "step"]

FINEST = 1 / 64
"""The smallest step, as a fraction of the largest."""

BELOW_ONE = 1 - 2.0**-24
"""The largest float below 1."""


def step(u: Float, a: Float, largest: Float) -> Float:
    """Move the number `u` in [0, 1) a little, as a uniform number `a` says: the interval is a circle.

    The distance lies between `largest` / 64 and `largest`, with a density that is proportional to its inverse. Steps to
    and fro are equally likely.
    """
    up = a < 0.5
    b = 2 * dr.select(up, a, a - 0.5)
    distance = largest * dr.exp2(b * math.log2(FINEST))
    moved = u + dr.select(up, distance, -distance)
    return minimum(moved - dr.floor(moved), BELOW_ONE)


@dataclass
class Mutated:
    """A `SampleStream` of a proposal: it mutates the numbers of a chain while they are drawn.

    Local memory has room for both. The proposal's numbers are written to the place that isn't the chain's, so that to
    accept them is to exchange the roles of the two.
    """

    generator: IndependentStream
    memory: Any
    own: UInt32
    """Index of the next number of the chain."""
    other: UInt32
    """Index at which the proposal's number is stored."""
    is_large: Bool
    """True where all numbers are drawn afresh."""
    largest: Float
    """The largest step of the others."""

    @staticmethod
    def of(
        generator: IndependentStream, memory: Any, second: Bool, size: int, is_large: Bool, largest: Float
    ) -> Mutated:
        """The numbers of a proposal; `second`: the chain's stand in the second half of the memory, after `size`."""
        first, middle = UInt32(0), UInt32(size)
        own, other = dr.select(second, middle, first), dr.select(second, first, middle)
        return Mutated(generator, memory, own, other, is_large, largest)

    def clone(self) -> Mutated:
        """Two of them would write to the same memory."""
        raise NotImplementedError("the numbers of a proposal are drawn once")

    def next_1d(self, active: Bool | bool = True) -> Float:
        a, u = self.generator.next_1d(), self.memory.read(self.own)
        number = dr.select(self.is_large, a, step(u, a, self.largest))
        self.memory.write(number, self.other)
        self.own, self.other = self.own + 1, self.other + 1
        return number

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        x = self.next_1d()
        return Point2f(x, self.next_1d())
