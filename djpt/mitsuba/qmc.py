"""Radical inverses: the coordinates of Van der Corput's, Sobol's and Halton's sequences."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.errors import ArgumentError
from djpt.jit.kernels import while_loop
from djpt.jit.types import Float, UInt32, UInt64, converting
from djpt.samplers import ldsampler

__all__ = ["RadicalInverse", "radical_inverse_2", "sobol_2"]

BELOW_ONE = 1 - 2.0**-24
"""The largest float below 1."""


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
