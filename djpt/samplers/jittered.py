"""The base of samplers that stratify a pixel's samples over the cells of a grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import drjit as dr

from djpt.description.properties import Properties
from djpt.jit.kernels import minimum
from djpt.jit.types import PCG32, Bool, Float, UInt32
from djpt.samplers.base import SampleIndex, Sampler
from djpt.samplers.independent import copy_of, generator
from djpt.samplers.seeds import quotient, sample_tea_32

__all__ = ["JitteredSampler", "JitteredStream", "PointSet", "PointSets", "below_one"]

BELOW_ONE = 1 - 2**-24
"""The largest float below 1."""

Stream = TypeVar("Stream", bound="JitteredStream")

SET_STEP = 0x9E3779B9


@dataclass
class PointSet:
    """The place of a sample among the samples of its pixel."""

    k: UInt32
    """Number of the sample in its set."""
    key: UInt32
    """Random, the same for all samples of the set."""


class PointSets(Sampler):
    """A sampler whose samples of a pixel depend on each other: `spp` of them are one set."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self._base = dr.opaque(UInt32, self.base_seed)

    def point_set(self, seed: UInt32, index: SampleIndex) -> PointSet:
        """The set of a sample; beyond the count, the next sets of the pixel follow.

        Mitsuba's hash takes the sampler's seed and render's apart.
        """
        number = quotient(index.k, index.spp)
        key, _ = sample_tea_32(self._base + number * SET_STEP, index.first + (seed - self._base))
        return PointSet(index.k - number * index.spp, key)


@dataclass
class JitteredStream:
    """Numbers from a grid of cells, randomly permuted in each dimension."""

    rng: PCG32 | None
    """The generator that jitters a sample within its cell; None: samples stay in the middle of their cells."""
    key: UInt32
    dimension: UInt32
    """The count of 1D and 2D draws, by inactive lanes as well (as in Mitsuba)."""
    k: UInt32
    resolution: UInt32

    def jitter(self, active: Bool | bool) -> Float:
        """The place of a sample in its cell, in [0, 1)."""
        return Float(0.5) if self.rng is None else self.rng.next_float32(Bool(active))

    def next_dimension(self) -> UInt32:
        """Return the number of the dimension that is drawn now, and advance it."""
        dimension = self.dimension
        self.dimension = dimension + 1
        return dimension

    def clone(self: Stream) -> Stream:
        return replace(self, rng=None if self.rng is None else copy_of(self.rng))


class JitteredSampler(PointSets):
    """A sampler with Mitsuba's parameter `jitter` (default true): random positions in the cells, or their middle."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.jitter = props.boolean("jitter", True)

    def continued(self, stream: Stream, fresh: Stream) -> Stream:
        return replace(fresh, rng=stream.rng)

    def generator(self, seed: UInt32, index: SampleIndex) -> PCG32 | None:
        """The generator that jitters a sample; None without `jitter`."""
        return generator(seed, index.number) if self.jitter else None


def below_one(x: Float) -> Float:
    """The number `x`; the largest float below 1 where rounding made it 1."""
    return minimum(x, BELOW_ONE)
