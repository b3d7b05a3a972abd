"""Owen-scrambled Sobol points, computed by hashing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr

from djpt.description.properties import Properties
from djpt.description.registry import register_sampler
from djpt.jit.types import Bool, Float, Point2f, UInt32
from djpt.samplers.base import SampleIndex, Sampler
from djpt.samplers.seeds import quotient, sample_tea_32

__all__ = ["Sobol", "SobolStream", "morton", "nested_shuffle", "pascal"]

GOLDEN = 0x9E3779B9
"""2^32 over the golden ratio: multiples of it stay apart modulo 2^32."""


@dataclass
class SobolStream:
    """A point of the sequence; each draw shuffles its index and scrambles its coordinates anew.

    Numbers are kept with the bit reversed that they have as fractions: the first bit is the lowest.
    """

    key: UInt32
    """The seed of hashes, advanced by every draw, also of inactive lanes: a pixel's samples share their dimensions."""
    order: UInt32
    """The index of the point, bits reversed."""

    def clone(self) -> SobolStream:
        return replace(self)

    def next_hash(self) -> UInt32:
        """Return a random number per key and draw, and advance the key."""
        key = self.key
        self.key = key + GOLDEN
        return mix(key)

    def next_1d(self, active: Bool | bool = True) -> Float:
        seed = self.next_hash()
        index = dr.brev(nested_shuffle(self.order, seed))
        return fraction(nested_shuffle(index, seed * 0x2C1B3C6D + 1))

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        seed = self.next_hash()
        index = dr.brev(nested_shuffle(self.order, seed))
        x = nested_shuffle(index, seed * 0x2C1B3C6D + 1)
        return Point2f(fraction(x), fraction(nested_shuffle(pascal(index), seed * 0x297A2D39 + 1)))


class Sobol(Sampler):
    """Sobol's (0, 2)-sequence, Owen-scrambled per pixel, and padded.

    Each pair of numbers, and each single one, is a shuffled and scrambled copy of its own.

    Of 2^m samples, each of the 2^a x 2^b boxes (a + b = m) that tile the unit square holds one, for every pair of
    numbers that are drawn together. Any count will do, powers of two are best; it isn't rounded, and samples beyond
    it continue the sequence.

    Parameters: `sample_count` (default 4), `seed`, `blue_noise` (default false).

    `blue_noise`: one scrambling for the whole image, whose pixels take consecutive pieces of the sequence in the
    order of a Z curve, shuffled as a tree. Neighbouring pixels then complete each other: what is left of the noise
    has high frequencies, and a blur or a denoiser removes it. The error of a single pixel stays the same.

    A. Owen, "Randomly Permuted (t,m,s)-Nets and (t,s)-Sequences", 1995; B. Burley, "Practical Hash-based Owen
    Scrambling", JCGT 2020; A. Ahmed and P. Wonka, "Screen-Space Blue-Noise Diffusion of Monte Carlo Sampling Error
    via Hierarchical Ordering of Pixels", 2020 (with a binary tree in place of their quadtree).
    """

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.blue_noise = props.boolean("blue_noise", False)
        # Its pixels have pieces of a sequence.
        self.continues = not self.blue_noise

    def stream(self, seed: UInt32, index: SampleIndex) -> SobolStream:
        if not self.blue_noise:
            key, _ = sample_tea_32(seed, index.pixel)
            return SobolStream(key, dr.brev(index.k))
        row = quotient(index.pixel, index.width)
        place = turn_quads(morton(index.pixel - row * index.width, row), seed)
        # Each pixel gets a piece of 2^bits points. Where the numbers of points run out of 32 bits, and for samples
        # beyond the count, the sequence is scrambled anew.
        bits = 32 - dr.lzcnt(index.spp - 1)
        bits = dr.select(bits > 31, 31, bits)
        again = index.k >> bits
        key, _ = sample_tea_32(seed + again * GOLDEN, (place >> 1) >> (31 - bits))
        return SobolStream(key, dr.brev((place << bits) | (index.k - (again << bits))))


def mix(x: UInt32) -> UInt32:
    """A bijection of 32-bit integers without visible structure: C. Wellons, "Hash Prospector", 2018."""
    x = (x ^ (x >> 16)) * 0x21F0AAAD
    x = (x ^ (x >> 15)) * 0xD35A2D97
    return x ^ (x >> 15)


def nested_shuffle(x: UInt32, seed: UInt32) -> UInt32:
    """Owen's scrambling of a number with reversed bits: each bit is flipped or not depending on all lower ones.

    S. Laine and T. Karras, "Stratified Sampling for Stochastic Transparency", 2011, with the operations of
    N. Vegdahl, "Building a Better LK Hash", 2021.
    """
    x = x ^ (x * 0x3D20ADEA)
    x = (x + seed) * ((seed >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)


def pascal(index: UInt32) -> UInt32:
    """The product of Pascal's upper triangle modulo 2 with the bits of `index`: Sobol's second coordinate, reversed.

    The matrix is the Kronecker product of five [[1, 1], [0, 1]]: each is one xor by bits that stand 1, 2, 4, 8, 16
    places further up.
    """
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF)):
        index = index ^ ((index >> shift) & mask)
    return index


def morton(x: UInt32, y: UInt32) -> UInt32:
    """The place of (x, y), both below 2^16, on a Z curve: their bits alternate."""
    return spread_bits(x) | (spread_bits(y) << 1)


def turn_quads(place: UInt32, seed: UInt32) -> UInt32:
    """Let chance decide which pixels of a 2 x 2 block are paired: rows, columns or diagonals.

    Blocks of 4 x 4 pixels are treated alike. On the Z curve the pairs would always be rows, and noise would differ
    by direction.
    """
    for level in (0, 2):
        low, high = (place >> level) & 1, (place >> (level + 1)) & 1
        choice = dr.mul_hi(mix(seed + (place >> (level + 2)) * GOLDEN), UInt32(3))
        new_low = dr.select(choice == 0, high, low)
        new_high = dr.select(choice == 0, low, dr.select(choice == 1, high, low ^ high))
        place = place ^ ((low ^ new_low) << level) ^ ((high ^ new_high) << (level + 1))
    return place


def spread_bits(x: UInt32) -> UInt32:
    """The lower 16 bits spread out: bit i is moved to 2 i."""
    x = x & 0xFFFF
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        x = (x | (x << shift)) & mask
    return x


def fraction(x: UInt32) -> Float:
    """The number in [0, 1) of reversed bits, of which a float holds 24."""
    return Float(dr.brev(x) >> 8) * 2**-24


register_sampler("sobol", Sobol)
