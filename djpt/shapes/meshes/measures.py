"""What is measured on a mesh: areas and extent, when they are asked for; shared edges; whether it is closed."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from djpt.shapes.meshes.normals import face_areas

__all__ = ["Measures", "is_closed", "is_remote", "opposite_edges"]

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


# ---- edges -------------------------------------------------------------------------------------------------------


def is_closed(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> bool:
    """Whether every edge belongs to an even number of triangles.

    Then any ray from a point far away crosses the mesh an even number of times on its way out, and parity
    tells inside from outside. Vertices at the same place count as one: seams of texture coordinates
    double them.
    """
    # Adding zero turns -0 into 0, so that equal numbers have equal bits.
    bits = np.ascontiguousarray(positions + np.float32(0)).view(np.dtype((np.void, 12))).ravel()
    _, place = np.unique(bits, return_inverse=True)
    corners = place[indices].astype(np.uint64)
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    ends.sort(axis=1)
    _, uses = np.unique(ends[:, 0] << np.uint64(32) | ends[:, 1], return_counts=True)
    return bool((uses % 2 == 0).all())


def opposite_edges(indices: NDArray[np.uint32], vertex_count: int) -> NDArray[np.uint32]:
    """The directed edge that runs against each directed edge, (3 F,); 2^32 - 1 where it isn't exactly one.

    Edge k of triangle f, number 3 f + k, runs from its corner k to the next one.
    """
    start = indices.astype(np.int64).ravel()
    end = np.roll(indices, -1, axis=1).astype(np.int64).ravel()
    forward, backward = start * vertex_count + end, end * vertex_count + start
    order = np.argsort(forward, kind="stable")
    ranked = forward[order]
    first, past = np.searchsorted(ranked, backward, "left"), np.searchsorted(ranked, backward, "right")
    own_first, own_past = np.searchsorted(ranked, forward, "left"), np.searchsorted(ranked, forward, "right")
    single = (past - first == 1) & (own_past - own_first == 1)
    result = np.full(len(start), 0xFFFFFFFF, np.uint32)
    result[single] = order[first[single]]
    return result
