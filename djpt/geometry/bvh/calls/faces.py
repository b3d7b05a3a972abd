"""The faces of scenes with few triangles, as tables that `djpt.geometry.bvh.calls.sweep` reads.

A face is a triangle, or two of one mesh that share an edge and lie in one plane on either side of it: no ray meets
both, so that one search for the nearest hit can take them together.

======  =====  =====================================================================================
part    words  contents
======  =====  =====================================================================================
CORNER  3      a point, which is a corner of one triangle or of several
FACE    8      the numbers of the corners of its first triangle and of its second, which is the first
               again if there is one alone; the numbers of both, counted from the first record
======  =====  =====================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.calls.layout import ROW_WORDS

__all__ = ["CORNER_BYTES", "FACE_BYTES", "FEW", "MOST_CORNERS", "Faces"]

CORNER, FACE = 3, 8
CORNER_BYTES, FACE_BYTES = 4 * CORNER, 4 * FACE

FEW = 24
"""The most faces that are swept."""

MOST_CORNERS = 2 * FEW
"""The most corners that they have."""

FLAT = 2.0**-22
"""How far the triangles of a face may be from one plane, in units of the diagonal of everything."""


@dataclass
class Faces:
    """The tables of a scene."""

    corners: NDArray[np.float32]
    """(C, CORNER)."""
    faces: NDArray[np.uint32]
    """(N, FACE)."""

    def header(self, row: int) -> list[int]:
        """The words of a tree's header from FACES_WORD on, if the tables begin at a row."""
        return [row, len(self.corners), len(self.faces)]

    @property
    def rows(self) -> NDArray[np.uint32]:
        """Both tables in rows of a tree's memory, (R, 8)."""
        words = np.concatenate([self.corners.view(np.uint32).ravel(), self.faces.ravel()])
        return np.pad(words, (0, -len(words) % ROW_WORDS)).reshape(-1, ROW_WORDS)

    @staticmethod
    def of(triangles: NDArray[np.float32], labels: NDArray[np.uint32], diagonal: float) -> Faces | None:
        """The faces of triangles (F, 3, 3), or None if they or their corners are too many.

        Triangles with different `labels`, (F,), are never joined.
        """
        if len(triangles) > 2 * FEW:
            return None
        corners, numbers = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
        numbers = numbers.reshape(-1, 3)
        pairs = joined(triangles.astype(np.float64), numbers, labels, diagonal)
        if len(pairs) > FEW or len(corners) > MOST_CORNERS:
            return None
        first, second = np.array(pairs).T
        return Faces(corners, np.column_stack([numbers[first], numbers[second], first, second]).astype(np.uint32))


def joined(
    corners: NDArray[np.float64], numbers: NDArray[np.int64], labels: NDArray[np.uint32], diagonal: float
) -> list[tuple[int, int]]:
    """The pairs of triangles that make a face; those that are alone are paired with themselves.

    Each is joined with the first of those before it that it may be joined with. `numbers` are those of points, (F, 3).
    """
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    partner = list(range(len(corners)))
    edges: dict[tuple[int, int], int] = {}

    def fit(i: int, j: int, opposite: int) -> bool:
        """Whether triangles with a common edge, opposite to a corner of the first, make a face."""
        if partner[i] != i or partner[j] != j or labels[i] != labels[j] or not normals[i] @ normals[j] > 0:
            return False
        beyond = abs(float(normals[j] @ (corners[i, opposite] - corners[j, 0])))
        return beyond <= FLAT * diagonal * float(lengths[j])

    for i, triangle in enumerate(numbers.tolist()):
        for k in range(3):
            start, end = triangle[k], triangle[(k + 1) % 3]
            j = edges.get((end, start), i)
            if j != i and fit(i, j, (k + 2) % 3):
                partner[i], partner[j] = j, i
            edges[start, end] = i
    return [(i, j) for i, j in enumerate(partner) if i <= j]
