"""Points of the unit cube that Markov chains move through: the random numbers of a sample, and how they mutate.

C. Kelemen, L. Szirmay-Kalos, G. Antal and F. Csonka, "A Simple and Robust Mutation Strategy for the Metropolis Light
Transport Algorithm", 2002.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.integrators.one_strategy import CAMERA, LIGHT, STRATEGY
from djpt.kernels import minimum
from djpt.samplers.independent import IndependentStream
from djpt.types import Bool, Float, Point2f, UInt32

__all__ = ["Fresh", "Mutated", "Mutation", "step"]

FINEST = 1 / 64
"""The smallest step, as a share of the largest."""

BELOW_ONE = 1 - 2.0**-24
"""The largest float below 1."""

EVERYTHING = STRATEGY | LIGHT | CAMERA

ONE_SIDE = 0.5
"""The share of small mutations that draw the numbers of one side afresh, and keep those of the other."""


def step(u: Float, a: Float, largest: Float) -> Float:
    """Move numbers in [0, 1) a little, by uniform ones `a`: up to `largest`, with the density 1 / distance, cyclically.

    Steps to and fro are equally likely.
    """
    up = a < 0.5
    b = dr.select(up, a, a - 0.5) * 2
    distance = largest * dr.exp2(b * math.log2(FINEST))
    moved = u + dr.select(up, distance, -distance)
    return minimum(moved - dr.floor(moved), BELOW_ONE)


@dataclass
class Fresh:
    """The numbers of independent samples: a `SidedStream` that doesn't mind sides."""

    generator: IndependentStream

    def clone(self) -> Fresh:
        return Fresh(self.generator.clone())

    def turn_to(self, side: UInt32) -> None:
        """All numbers are alike."""

    def next_1d(self, active: Bool | bool = True) -> Float:
        return self.generator.next_1d(active)

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        return self.generator.next_2d(active)


@dataclass
class Mutation:
    """Which numbers of a proposal are new ones, and which are moved: sums of `STRATEGY`, `LIGHT` and `CAMERA`.

    Those of neither are kept. A proposal is as likely as the way back, because what happens to a number doesn't depend
    on any.
    """

    fresh: UInt32
    moved: UInt32

    @staticmethod
    def chosen(u: Float, large: Float) -> Mutation:
        """The mutation that a uniform number `u` chooses: a large step, all numbers afresh, with probability `large`.

        The others keep the strategy.
        """
        rest = (u - large) * dr.rcp(1 - large)
        is_large, one_side = u < large, rest < ONE_SIDE
        side = dr.select(rest < 0.5 * ONE_SIDE, UInt32(LIGHT), CAMERA)
        fresh = dr.select(is_large, UInt32(EVERYTHING), dr.select(one_side, side, 0))
        return Mutation(fresh, dr.select(is_large | one_side, UInt32(0), LIGHT | CAMERA))

    @property
    def is_large(self) -> Bool:
        """Whether all numbers are new."""
        return self.fresh == EVERYTHING


@dataclass
class Mutated:
    """The numbers of a proposal: a `SidedStream` that mutates those of a chain while they are drawn.

    A chain's memory has room for two points. The proposal is written to the one that isn't the chain's, so that
    accepting it is to change the roles of the two.
    """

    generator: IndependentStream
    memory: Any
    """Both points, number by number, in local memory."""
    place: UInt32
    """Where the next number of the chain stands."""
    other: UInt32
    """Where that of the proposal stands."""
    mutation: Mutation
    side: UInt32
    largest: Float
    """The largest step."""

    @staticmethod
    def of(
        generator: IndependentStream, memory: Any, second: Bool, size: int, mutation: Mutation, largest: Float
    ) -> Mutated:
        """The numbers of a proposal; `second`: the chain is at the second of the two points, of `size` numbers."""
        place, other = dr.select(second, UInt32(size), 0), dr.select(second, UInt32(0), size)
        return Mutated(generator, memory, place, other, mutation, UInt32(0), largest)

    def clone(self) -> Mutated:
        raise NotImplementedError("a proposal is drawn once")

    def turn_to(self, side: UInt32) -> None:
        """The numbers that follow decide on one of `STRATEGY`, `LIGHT`, `CAMERA`."""
        self.side = UInt32(side)

    def next_1d(self, active: Bool | bool = True) -> Float:
        a, u = self.generator.next_1d(active), self.memory.read(self.place)
        moved = dr.select((self.mutation.moved & self.side) != 0, step(u, a, self.largest), u)
        number = dr.select((self.mutation.fresh & self.side) != 0, a, moved)
        self.memory.write(number, self.other)
        self.place, self.other = self.place + 1, self.other + 1
        return number

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        x = self.next_1d(active)
        return Point2f(x, self.next_1d(active))
