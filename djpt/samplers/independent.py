"""Independent uniform random numbers."""

from __future__ import annotations

from typing import Any, ClassVar

from djpt.description.registry import register_sampler
from djpt.samplers.base import SampleIndex, Sampler
from djpt.samplers.hashing import sample_tea_32
from djpt.types import PCG32, Bool, Float, Point2f, UInt32, UInt64

__all__ = ["Independent", "IndependentStream", "copy_of", "generator"]

MULTIPLIER = 0x5851F42D4C957F2D


class IndependentStream:
    """A PCG32 generator (M. O'Neill, 2014) per lane."""

    DRJIT_STRUCT: ClassVar[dict[str, Any]] = {"rng": PCG32}

    def __init__(self, rng: PCG32 | None = None) -> None:
        if rng is not None:
            self.rng = rng

    def clone(self) -> IndependentStream:
        return IndependentStream(copy_of(self.rng))

    def next_1d(self, active: Bool | bool = True) -> Float:
        return self.rng.next_float32(Bool(active))

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        x = self.rng.next_float32(Bool(active))
        return Point2f(x, self.rng.next_float32(Bool(active)))


class Independent(Sampler):
    """Every number independent of all others: the streams of Mitsuba's `independent`.

    The generator of sample number i is seeded by the two words of `sample_tea_32(seed, i)`.
    """

    def stream(self, seed: UInt32, index: SampleIndex) -> IndependentStream:
        return IndependentStream(generator(seed, index.number))

    def continued(self, stream: IndependentStream, fresh: IndependentStream) -> IndependentStream:
        return stream


def generator(seed: UInt32, number: UInt32) -> PCG32:
    """The generator of sample `number` of an image."""
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
