"""Independent uniform random numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.description.registry import register_sampler
from djpt.jit.kernels import float_in
from djpt.jit.types import PCG32, Bool, Float, Point2f, UInt32, UInt64
from djpt.samplers.base import SampleIndex, Sampler
from djpt.samplers.seeds import sample_tea_32

__all__ = ["Independent", "IndependentStream", "copy_of", "generator"]

MULTIPLIER = 0x5851F42D4C957F2D
LOW, HIGH = MULTIPLIER & 0xFFFFFFFF, MULTIPLIER >> 32


@dataclass
class IndependentStream:
    """A PCG32 generator (M. O'Neill, 2014) per lane: the numbers of Dr.Jit's, which is one step ahead.

    The state s is advanced when a number is drawn, s -> a s + 2 sequence + 1, and not after it: where lanes begin new
    streams one step is made, not one for the old and one for the new. It is kept in two words, since processors
    without AVX-512 have no multiplication of vectors of 64-bit numbers.
    """

    low: UInt32
    """The lower half of the state."""
    high: UInt32
    """The upper half."""
    sequence: UInt32
    """The number of the sequence that the state runs through."""

    @staticmethod
    def seeded(start: UInt32, sequence: UInt32) -> IndependentStream:
        """The generator `PCG32(initstate=start, initseq=sequence)`."""
        low, high = increment(sequence)
        return IndependentStream(*added(low, high, start), sequence)

    def clone(self) -> IndependentStream:
        return IndependentStream(UInt32(self.low), UInt32(self.high), UInt32(self.sequence))

    def next_1d(self, active: Bool | bool = True) -> Float:
        low, high = increment(self.sequence)
        carried: Any = dr.mul_hi(self.low, UInt32(LOW))
        high += carried + self.low * HIGH + self.high * LOW
        low, high = added(self.low * LOW, high, low)
        self.low, self.high = dr.select(active, low, self.low), dr.select(active, high, self.high)
        return uniform(low, high)

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        x = self.next_1d(active)
        return Point2f(x, self.next_1d(active))


def increment(sequence: UInt32) -> tuple[UInt32, UInt32]:
    """The words of 2 `sequence` + 1."""
    return (sequence << 1) | 1, sequence >> 31


def added(low: UInt32, high: UInt32, number: UInt32) -> tuple[UInt32, UInt32]:
    """The words of a sum; `low` and `high` are those of its first term."""
    total = low + number
    return total, high + dr.select(total < number, UInt32(1), 0)


def uniform(low: UInt32, high: UInt32) -> Float:
    """The number in [0, 1) that a state of PCG32 gives: its upper bits, rotated, as the digits of a float."""
    word, turn = ((high << 5) | (low >> 27)) ^ (high >> 13), high >> 27
    word = (word >> turn) | (word << ((~turn + 1) & 31))
    return float_in((word >> 9) | 0x3F800000) - 1


class Independent(Sampler):
    """Every number independent of all others: the streams of Mitsuba's `independent`.

    The generator of sample number i is seeded by the two words of `sample_tea_32(seed, i)`.
    """

    def stream(self, seed: UInt32, index: SampleIndex) -> IndependentStream:
        v0, v1 = sample_tea_32(seed, index.number)
        return IndependentStream.seeded(v0, v1)

    def continued(self, stream: IndependentStream, fresh: IndependentStream) -> IndependentStream:
        return stream


def generator(seed: UInt32, number: UInt32) -> PCG32:
    """The generator of sample `number` of an image, as Dr.Jit has it."""
    v0, v1 = sample_tea_32(seed, number)
    # The constructor of PCG32 adds a lane counter to the sequence number, which inside a
    # symbolic loop counts the loop's lanes whatever `size` says: so seed by hand.
    rng = PCG32()
    rng.inc = (UInt64(v1) << 1) | 1
    rng.state = (rng.inc + UInt64(v0)) * MULTIPLIER + rng.inc
    return rng


def copy_of(rng: PCG32) -> PCG32:
    """A generator that continues with the same numbers."""
    copy = PCG32()
    copy.state, copy.inc = UInt64(rng.state), UInt64(rng.inc)
    return copy


register_sampler("independent", Independent)
