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
    """(3,); +inf if there is nothing."""
    max: NDArray[np.float64]
    """(3,); -inf if there is nothing."""

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        return iter((self.min, self.max))

    def valid(self) -> bool:
        """Is there any point in it?"""
        return bool(np.all(self.max >= self.min))

    def center(self) -> NDArray[np.float64]:
        """The middle."""
        return (self.min + self.max) / 2

    def extents(self) -> NDArray[np.float64]:
        """The lengths of the sides."""
        return self.max - self.min

    def volume(self) -> float:
        """The product of the sides; 0 if there is nothing."""
        return float(np.prod(self.extents())) if self.valid() else 0.0

    def surface_area(self) -> float:
        """The area of the six faces; 0 if there is nothing."""
        a, b, c = self.extents() if self.valid() else (0.0, 0.0, 0.0)
        return float(2 * (a * b + b * c + c * a))

    def contains(self, p: ArrayLike) -> bool:
        """Is a point in it, faces included?"""
        return bool(np.all((np.asarray(p) >= self.min) & (np.asarray(p) <= self.max)))
