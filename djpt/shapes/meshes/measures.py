"""The areas and the extent of a mesh, computed when they are asked for: few meshes are lights."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from djpt.shapes.meshes.normals import face_areas

__all__ = ["Measures", "is_remote"]

REMOTE = 16


def is_remote(positions: NDArray[np.float32]) -> bool:
    """Whether vertices (V, 3) lie further from the origin than REMOTE times their extent."""
    if not len(positions):
        return False
    low, high = positions.min(axis=0), positions.max(axis=0)
    return bool(np.abs(0.5 * (low + high)).max() > REMOTE * (high - low).max())


class Measures:
    """What is measured on the triangles of a mesh; the arrays must stay as they are."""

    def __init__(
        self, positions: NDArray[np.float32], indices: NDArray[np.uint32], areas: NDArray[np.float64] | None = None
    ) -> None:
        """`areas` are those of the triangles if they are known."""
        self._positions, self._indices = positions, indices
        if areas is not None:
            self.face_areas = areas

    @cached_property
    def face_areas(self) -> NDArray[np.float64]:
        """The areas of all triangles, (F,)."""
        return face_areas(self._positions, self._indices)

    @cached_property
    def area(self) -> float:
        """The area of all triangles."""
        return float(self.face_areas.sum())

    @cached_property
    def _used(self) -> NDArray[np.float32]:
        """The positions of the vertices that triangles use, axis by axis: (3, V)."""
        used = np.zeros(len(self._positions), bool)
        used[self._indices.ravel()] = True
        return np.ascontiguousarray((self._positions if used.all() else self._positions[used]).T)

    @cached_property
    def _box(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        return self._used.min(axis=1), self._used.max(axis=1)

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        """The lowest and the highest coordinate along a direction (3,)."""
        (axes,) = np.nonzero(direction)
        if len(axes) == 1 and direction[axes[0]] == 1:
            low, high = self._box
            return float(low[axes[0]]), float(high[axes[0]])
        along = direction @ self._used
        return float(along.min()), float(along.max())
