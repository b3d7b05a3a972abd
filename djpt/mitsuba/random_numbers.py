"""Random and quasi-random numbers of scripts: hashes of seeds, permutations, and radical inverses.

Radical inverses are the coordinates of Van der Corput's, Sobol's and Halton's sequences.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.errors import ArgumentError
from djpt.jit.kernels import float_in, while_loop
from djpt.jit.types import PCG32, Bool, Float, Float64, UInt32, UInt64, backend, converting
from djpt.samplers import ldsampler, seeds

__all__ = [
    "PCG32",
    "Philox4x32",
    "RadicalInverse",
    "ScalarPCG32",
    "permute",
    "permute_kensler",
    "radical_inverse_2",
    "sample_tea_32",
    "sample_tea_64",
    "sample_tea_float",
    "sample_tea_float32",
    "sample_tea_float64",
    "sobol_2",
]

Philox4x32 = backend.Philox4x32
ScalarPCG32 = dr.scalar.PCG32

BELOW_ONE = 1 - 2.0**-24
"""The largest float below 1."""


def sample_tea_32(v0: Any, v1: Any, rounds: int = 4) -> tuple[Any, Any]:
    """Two 32-bit hashes of two 32-bit words: see `djpt.samplers.seeds`. Of two Python integers they are such, too."""
    hashes = seeds.sample_tea_32(UInt32(v0), UInt32(v1), rounds)
    return (hashes[0][0], hashes[1][0]) if are_integers(v0, v1) else hashes


def sample_tea_64(v0: Any, v1: Any, rounds: int = 4) -> Any:
    """Both hashes of `sample_tea_32` as one 64-bit integer; the second one is its upper half."""
    low, high = seeds.sample_tea_32(UInt32(v0), UInt32(v1), rounds)
    word = UInt64(low) + (UInt64(high) << 32)
    return word[0] if are_integers(v0, v1) else word


def sample_tea_float32(v0: Any, v1: Any, rounds: int = 4) -> Any:
    """A number in [0, 1) from the upper 23 bits of the second hash of `sample_tea_32`."""
    _, word = seeds.sample_tea_32(UInt32(v0), UInt32(v1), rounds)
    number = float_in((word >> 9) | 0x3F800000) - 1
    return number[0] if are_integers(v0, v1) else number


def sample_tea_float64(v0: Any, v1: Any, rounds: int = 4) -> Any:
    """A number in [0, 1) in double precision, from the upper 52 bits of `sample_tea_64`."""
    low, high = seeds.sample_tea_32(UInt32(v0), UInt32(v1), rounds)
    word = UInt64(low) + (UInt64(high) << 32)
    doubles: Any = dr.reinterpret_array(Float64, (word >> 12) | 0x3FF0000000000000)
    number = doubles - 1
    return number[0] if are_integers(v0, v1) else number


sample_tea_float = sample_tea_float32


def are_integers(*values: Any) -> bool:
    """Whether these are Python's integers."""
    return all(isinstance(value, int) for value in values)


@converting
def permute(value: UInt32, size: int, seed: UInt32, rounds: int = 4) -> UInt32:
    """The image of `value` under the permutation number `seed` of [0, size), a power of two.

    A network of random swaps, each decided by `rounds` rounds of `sample_tea_32`.
    """
    if size < 1 or size & (size - 1):
        raise ArgumentError(f"permute(): 'size' must be a power of two, found {size}")
    # Not `ldsampler.permute`, which is a loop: the size is known here.
    for layer in range(size.bit_length() - 1):
        value = ldsampler.swap(1 << layer, value, seed, rounds)
    return value


@converting
def permute_kensler(i: UInt32, l: int, p: UInt32, active: Bool | bool = True) -> UInt32:  # noqa: E741
    """The image of `i` under the permutation number `p` of [0, l), by A. Kensler, see `djpt.samplers.seeds`."""
    if l == 1:
        return dr.zeros(UInt32, dr.width(i))
    # Lane-wide, as loops ask for.
    return seeds.permute_kensler(i | (p & 0), UInt32(l), p)


@converting
def radical_inverse_2(index: UInt32, scramble: UInt32) -> Float:
    """Van der Corput's sequence: the bits of `index` mirrored at the binary point, and xored with `scramble`."""
    return ldsampler.radical_inverse(index, scramble)


@converting
def sobol_2(index: UInt32, scramble: UInt32) -> Float:
    """The second coordinate of Sobol's sequence, its bits xored with `scramble`."""
    return ldsampler.sobol_2(index, scramble)


class RadicalInverse:
    """Radical inverses in all prime bases up to a largest one, and permutations of their digits.

    Args:
        max_base: the largest number that may be a base.
        scramble: -1 for Faure's permutations, else random ones. These are the same for all seeds, as in Mitsuba.

    H. Faure, "Good permutations for extreme discrepancy", Journal of Number Theory 42(1), 1992.
    """

    def __init__(self, max_base: int = 8161, scramble: int = -1) -> None:
        if max_base < 2:
            raise ArgumentError(f"RadicalInverse(): 'max_base' must be at least 2, found {max_base}")
        candidates = np.ones(max_base + 1, bool)
        candidates[:2] = False
        for i in range(2, int(max_base**0.5) + 1):
            if candidates[i]:
                candidates[i * i :: i] = False
        self._primes = np.flatnonzero(candidates).tolist()
        self._scramble = scramble
        self._faure: list[list[int]] = [[], [0]]
        self._random: list[list[int]] = []
        self._generator = dr.scalar.PCG32()

    def bases(self) -> int:
        """The number of bases."""
        return len(self._primes)

    def base(self, arg: int, /) -> int:
        """Base number `arg`: the primes in order, from 2."""
        if not 0 <= arg < len(self._primes):
            raise ArgumentError(f"RadicalInverse: base {arg} doesn't exist; 'max_base' allows {len(self._primes)}")
        prime: int = self._primes[arg]
        return prime

    def scramble(self) -> int:
        """The seed of the permutations, -1 for Faure's."""
        return self._scramble

    def eval(self, base_index: int, index: Any) -> Float:
        """The digits of the 64-bit integer `index` in a base, mirrored at the point: in [0, 1)."""
        base = self.base(base_index)
        number = UInt64(index)

        def step(number: UInt64, value: UInt64, factor: Float) -> tuple[UInt64, UInt64, Float]:
            rest = number // base
            return rest, value * base + (number - rest * base), factor * (1 / base)

        # Lane-wide, as loops ask for.
        start = (number, number & 0, Float(number & 0) + 1)
        _, value, factor = while_loop(start, lambda n, v, f: n != 0, step, label="radical inverse")
        return dr.minimum(Float(value) * factor, BELOW_ONE)

    def permutation(self, arg: int, /) -> NDArray[np.uint16]:
        """The permutation of the digits of base number `arg`."""
        base = self.base(arg)
        if self._scramble == -1:
            while len(self._faure) <= base:
                self._faure.append(self._next_faure())
            return np.array(self._faure[base], np.uint16)
        while len(self._random) <= arg:
            self._random.append(self._shuffled(self._primes[len(self._random)]))
        return np.array(self._random[arg], np.uint16)

    def inverse_permutation(self, arg: int, /) -> int:
        """The digit that the permutation of base number `arg`, 0 or 1, takes to 0."""
        return int(np.argsort(self.permutation(arg))[0])

    def _next_faure(self) -> list[int]:
        """Faure's permutation of the first base that has none yet, from those of smaller bases."""
        base = len(self._faure)
        if base % 2 == 0:
            half = self._faure[base // 2]
            return [2 * digit for digit in half] + [2 * digit + 1 for digit in half]
        middle = base // 2
        digits = [digit + (digit >= middle) for digit in self._faure[base - 1]]
        return [*digits[:middle], middle, *digits[middle:]]

    def _shuffled(self, count: int) -> list[int]:
        """A random permutation, by exchanges from the end (R. A. Fisher and F. Yates, 1938)."""
        digits = list(range(count))
        for i in range(count - 1, 0, -1):
            j = self._generator.next_uint32_bounded(i + 1)
            digits[i], digits[j] = digits[j], digits[i]
        return digits

    def __repr__(self) -> str:
        return f"RadicalInverse[base_count={self.bases()}, scramble={self._scramble}]"
