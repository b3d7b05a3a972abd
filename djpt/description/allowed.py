"""Ranges of numbers that a texture may hold, and their wording in messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError

__all__ = ["LARGEST", "Allowed", "bounds"]

LARGEST = 1e30
"""The bound of radiance and its like: sums of a hundred million such samples are finite in single precision."""


@dataclass(frozen=True)
class Allowed:
    """A range of numbers; a bound of None is no bound."""

    low: float | None = None
    high: float | None = None
    low_open: bool = False
    """True if `low` itself is outside of the range."""

    def within(self, other: Allowed) -> Allowed:
        """The intersection of two ranges."""
        lows = [x for x in (self.low, other.low) if x is not None]
        highs = [x for x in (self.high, other.high) if x is not None]
        low = max(lows, default=None)
        low_open = any(a.low_open and a.low == low for a in (self, other))
        return Allowed(low, min(highs, default=None), low_open)

    def require(self, numbers: NDArray[Any], where: str = "") -> None:
        """Raise `SceneError` if a number lies outside; `where` starts the message."""
        # Numbers may be float32, which rounds 0.1 up: the bounds are compared as float32, too.
        smallest = -np.inf if self.low is None else np.float32(self.low)
        largest = np.inf if self.high is None else np.float32(self.high)
        # Nearly always the extremes tell; a NaN among them doesn't.
        if numbers.size and numbers.max() <= largest:
            least = numbers.min()
            if least > smallest or (least == smallest and not self.low_open):
                return
        outside = numbers[(numbers <= smallest if self.low_open else numbers < smallest) | (numbers > largest)]
        if outside.size:
            raise SceneError(f"{where} must {self._missed_by(outside[0])}, found {outside[0]:.6g}".lstrip())

    def _missed_by(self, number: float) -> str:
        """The range in words; of `LARGEST`, which only the largest numbers miss, only those hear."""
        if self.high != LARGEST:
            return bounds(self.low, self.high, self.low_open)
        return bounds(None, self.high) if number > LARGEST else bounds(self.low, None, self.low_open)


def bounds(low: float | None, high: float | None, low_open: bool = False, high_open: bool = False) -> str:
    """Put a range in words: ``lie in [0, 1]``, ``be at least 1``, ``be greater than 0``."""
    if low is not None and high is not None:
        return f"lie in {'(' if low_open else '['}{low:g}, {high:g}{')' if high_open else ']'}"
    if low is not None:
        return f"be {'greater than' if low_open else 'at least'} {low:g}"
    return f"be {'less than' if high_open else 'at most'} {high:g}"
