"""Axis-aligned bounding boxes, on the host."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["BoundingBox3f"]


@dataclass(frozen=True)
class BoundingBox3f:
    """All points between two corners, world space; ``low, high = box`` gives the corners."""

    min: NDArray[np.float64]
    """The smallest corner, (3,); +inf if the box is empty."""
    max: NDArray[np.float64]
    """The largest corner, (3,); -inf if the box is empty."""

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        return iter((self.min, self.max))

    def valid(self) -> bool:
        """Whether the box holds any point."""
        return bool(np.all(self.max >= self.min))

    def center(self) -> NDArray[np.float64]:
        """The middle of the box, (3,)."""
        return (self.min + self.max) / 2

    def extents(self) -> NDArray[np.float64]:
        """The lengths of the sides, (3,)."""
        return self.max - self.min

    def volume(self) -> float:
        """The product of the sides; 0 if the box is empty."""
        return float(np.prod(self.extents())) if self.valid() else 0.0

    def surface_area(self) -> float:
        """The area of the six faces; 0 if the box is empty."""
        a, b, c = self.extents() if self.valid() else (0.0, 0.0, 0.0)
        return float(2 * (a * b + b * c + c * a))

    def contains(self, p: ArrayLike) -> bool:
        """Whether the point `p`, (3,), lies in the box, faces included."""
        return bool(np.all((np.asarray(p) >= self.min) & (np.asarray(p) <= self.max)))
