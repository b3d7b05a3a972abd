"""A scrambled (0, 2)-sequence in random order."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr

from djpt.description.registry import register_sampler
from djpt.jit.kernels import while_loop
from djpt.jit.types import Bool, Float, Point2f, UInt32
from djpt.samplers.base import SampleIndex
from djpt.samplers.jittered import PointSets, below_one
from djpt.samplers.seeds import sample_tea_32
from djpt.samplers.sobol import pascal

__all__ = ["LDSampler", "LDStream"]


@dataclass
class LDStream:
    """The points of a set, permuted in each dimension but scrambled alike."""

    key: UInt32
    dimension: UInt32
    k: UInt32
    count: UInt32

    def clone(self) -> LDStream:
        return replace(self)

    def point(self) -> UInt32:
        """Return the number of the sample's point in the next dimension, and advance the dimension."""
        seed = self.key + self.dimension
        self.dimension = self.dimension + 1
        return permute(self.k, self.count, seed)

    def next_1d(self, active: Bool | bool = True) -> Float:
        scramble, _ = sample_tea_32(self.key, 0x48BC48EB)
        return radical_inverse(self.point(), scramble)

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        point = self.point()
        scramble = sample_tea_32(self.key, 0x98BC51AB)
        return Point2f(radical_inverse(point, scramble[0]), sobol_2(point, scramble[1]))


class LDSampler(PointSets):
    """The first points of Sobol's (0, 2)-sequence, xor-scrambled per pixel, permuted per dimension.

    Parameters: `sample_count` (rounded up to a power of 4, default 4), `seed`.

    T. Kollig and A. Keller, "Efficient Multidimensional Sampling", 2002. Numbers and pixels are Mitsuba's. A pixel
    scrambles all dimensions by the same numbers: `sobol` is better.
    """

    def round_count(self, spp: int) -> int:
        return max(4, 4 ** -(-(spp - 1).bit_length() // 2))

    def stream(self, seed: UInt32, index: SampleIndex) -> LDStream:
        samples = self.point_set(seed, index)
        return LDStream(samples.key, UInt32(0), samples.k, UInt32(index.spp))


def permute(index: UInt32, count: UInt32, seed: UInt32) -> UInt32:
    """The image of `index` under the permutation number `seed` of [0, count), a power of two; Mitsuba's `permute`.

    A network of log2(count) layers of random swaps, each decided by two rounds of `sample_tea_32`.
    """

    def layer(bit: UInt32, index: UInt32) -> tuple[UInt32, UInt32]:
        return bit << 1, swap(bit, index, seed, 2)

    # Lane-wide from the start, as loops ask for.
    bit = UInt32(1) | (index & 0) | (seed & 0)
    _, index = while_loop((bit, index | (bit & 0)), lambda bit, index: bit < count, layer, label="shuffle")
    return index


def swap(bit: UInt32 | int, index: UInt32, seed: UInt32, rounds: int) -> UInt32:
    """Exchange indices that differ in one bit, or don't: the same decision for each such pair."""
    random, _ = sample_tea_32(index | bit, seed, rounds)
    return index ^ (random & bit)


def radical_inverse(index: UInt32, scramble: UInt32) -> Float:
    """The bits of `index`, mirrored at the binary point."""
    bits = dr.brev(index) ^ scramble
    return Float(dr.reinterpret_array(Float, (bits >> 9) | 0x3F800000)) - 1


def sobol_2(index: UInt32, scramble: UInt32) -> Float:
    """The second coordinate of Sobol's sequence: Pascal's triangle modulo 2 times the bits of `index`."""
    return below_one(Float(dr.brev(pascal(index)) ^ scramble) * 2**-32)


register_sampler("ldsampler", LDSampler)
