"""Choices among many by weights in memory, whose number isn't part of a kernel."""

from __future__ import annotations

import drjit as dr

from djpt.jit.types import Bool, Float, UInt32

__all__ = ["Weights"]


class Weights:
    """Numbers i with the probability w_i / sum w, chosen by inverting running sums."""

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
