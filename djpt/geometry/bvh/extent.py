"""The box about a tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Extent"]


@dataclass
class Extent:
    """The box about everything in a tree."""

    low: NDArray[np.float32]
    high: NDArray[np.float32]

    @property
    def center(self) -> NDArray[np.float32]:
        """The middle."""
        return ((self.low.astype(np.float64) + self.high) / 2).astype(np.float32)

    @property
    def diagonal(self) -> float:
        """The length of the diagonal."""
        return float(np.linalg.norm(self.high.astype(np.float64) - self.low))

    @property
    def scale(self) -> float:
        """1 / the diagonal."""
        return 1 / max(self.diagonal, 1e-30)

    @property
    def area(self) -> float:
        """Half the surface area in units of the squared diagonal."""
        x, y, z = (self.high.astype(np.float64) - self.low) * self.scale
        return float(x * y + y * z + z * x)
