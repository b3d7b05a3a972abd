"""Discrete distributions with fixed weights."""

from __future__ import annotations

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.lookup import Rows
from djpt.jit.kernels import as_float
from djpt.jit.types import Float, UInt32

__all__ = ["Discrete"]


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
