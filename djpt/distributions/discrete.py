"""Choices among numbers by their weights: few, which are fixed, or many, in memory."""

from __future__ import annotations

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.lookup import Rows
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Float, UInt32

__all__ = ["Discrete", "Weights"]


class Discrete:
    """A distribution that gives the number i the probability w_i / sum w; sampled by inverting the cumulative sums."""

    def __init__(self, weights: NDArray[np.float64]) -> None:
        """Build the tables; `weights` are finite, not negative, and not all 0."""
        chances = weights / weights.sum()
        ends = np.cumsum(chances)
        # Rounding must not lead to a weight of 0 at the end.
        ends[np.nonzero(weights)[0][-1] :] = 1.0
        self._last = len(weights) - 1
        self._chances = Rows([as_float(x) for x in chances])
        self._begins = Rows([as_float(x) for x in np.concatenate([[0.0], ends[:-1]])])

    def choose(self, u: Float) -> tuple[UInt32, Float, Float]:
        """Choose a number by the uniform number `u`.

        Returns:
            The number, the inverse of its probability (0 if rounding led to a weight of 0), a fresh uniform number.
        """
        # The last one that begins at or before `u` and has a chance: equal beginnings are empty ones.
        index = UInt32(dr.binary_search(0, self._last, lambda i: self._begins.at(UInt32(i + 1)) <= u))
        inverse = dr.rcp(self._chances.at(index))
        left = (u - self._begins.at(index)) * inverse
        return index, dr.select(dr.isfinite(inverse), inverse, 0), dr.clip(left, 0, 1 - 2**-24)

    def probability(self, index: UInt32) -> Float:
        """The probability of the number `index`; unspecified beyond the last."""
        return self._chances.at(index)


class Weights:
    """Numbers i with the probability w_i / sum w, chosen by inverting running sums; how many is no part of kernels."""

    def __init__(self, weights: Float) -> None:
        """Compute the sums; `weights` aren't negative. If all are 0, every choice has the probability 0."""
        self._weights = dr.detach(weights)
        self._sums = dr.cumsum(self._weights)
        self._last = len(self._weights) - 1
        total = dr.gather(Float, self._sums, UInt32(self._last))
        self._total, self._inverse = total, dr.select(total > 0, dr.rcp(total), 0)
        dr.eval(self._weights, self._sums, self._total, self._inverse)

    def choose(self, u: Float, active: Bool | bool = True) -> tuple[UInt32, Float, Float]:
        """A number by the uniform number `u`, what is left of `u`, uniform again, and the number's probability."""
        wanted = u * self._total

        def before(index: UInt32) -> Bool:
            end = dr.gather(Float, self._sums, UInt32(index), active)
            return ((end < wanted) | (end == 0)) & (end != self._total)

        index = UInt32(dr.binary_search(0, self._last, before))
        probability = self.probability(index, active)
        left = (u - self.probability_below(index, active)) / probability
        return index, dr.select(probability > 0, left, 0), probability

    def probability(self, index: UInt32, active: Bool | bool = True) -> Float:
        """The probability of a number."""
        return dr.gather(Float, self._weights, index, active) * self._inverse

    def probability_below(self, index: UInt32, active: Bool | bool = True) -> Float:
        """The probability of all smaller numbers."""
        return dr.gather(Float, self._sums, index - 1, (index > 0) & active) * self._inverse
