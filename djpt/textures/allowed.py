"""The values that a texture may have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.description.properties import bounds
from djpt.errors import SceneError

__all__ = ["Allowed"]


@dataclass(frozen=True)
class Allowed:
    """A range of numbers; None: no bound."""

    low: float | None = None
    high: float | None = None
    low_open: bool = False
    """Is `low` itself outside?"""

    def within(self, other: Allowed) -> Allowed:
        """What lies in both ranges."""
        lows = [x for x in (self.low, other.low) if x is not None]
        highs = [x for x in (self.high, other.high) if x is not None]
        low = max(lows, default=None)
        low_open = any(a.low_open and a.low == low for a in (self, other))
        return Allowed(low, min(highs, default=None), low_open)

    def require(self, numbers: NDArray[Any], where: str = "") -> None:
        """Raise `SceneError` if a number lies outside; `where` starts the message."""
        # float32 rounds 0.1 up: compare what the user wrote, as float32.
        smallest = -np.inf if self.low is None else np.float32(self.low)
        largest = np.inf if self.high is None else np.float32(self.high)
        outside = numbers[(numbers <= smallest if self.low_open else numbers < smallest) | (numbers > largest)]
        if outside.size:
            raise SceneError(
                f"{where} must {bounds(self.low, self.high, self.low_open)}, found {outside[0]:.6g}".lstrip()
            )
