"""The contents of a BVH's leaves: triangles, and shapes and instances that rays reach through a transform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.records import LEAF

__all__ = ["PlacedLeaves", "TriangleLeaves"]


@dataclass
class TriangleLeaves:
    """Triangles as leaves; the first axis of all arrays is the face."""

    corners: NDArray[np.float32]
    """The corners, (F, 3, 3): face, corner, axis."""
    mesh: NDArray[np.uint32]
    normal: NDArray[np.float32]
    """The unit normals, (F, 3)."""
    direction: NDArray[np.float32]
    """The directions of dp/du, (F, 2), see `djpt.geometry.face_frames`."""
    first_face: int = 0
    """The set-wide number of the first triangle."""

    def write(
        self, words: NDArray[np.uint32], at: NDArray[np.uint32], of: NDArray[np.int32], center: NDArray[np.float32]
    ) -> None:
        words[at, :9] = (self.corners[of] - center).reshape(-1, 9).view(np.uint32)
        words[at, 9:12] = self.normal[of].view(np.uint32)
        words[at, 12] = self.mesh[of] | np.uint32(LEAF)
        words[at, 13] = of + self.first_face
        words[at, 14:] = self.direction[of].view(np.uint32)

    def write_rows(self, rows: NDArray[np.uint32], order: NDArray[np.uint32]) -> None:
        """Write the rows of the triangles in the given order, as `djpt.geometry.query.RayTree` has them."""
        rows[:, 1:4] = self.normal[order].view(np.uint32)
        rows[:, 4] = self.mesh[order] | np.uint32(LEAF)
        rows[:, 5] = order + np.uint32(self.first_face)
        rows[:, 6:] = self.direction[order].view(np.uint32)


@dataclass
class PlacedLeaves:
    """Triangles first, then I leaves with a transform: analytic shapes and instances."""

    triangles: TriangleLeaves
    inverse: NDArray[np.float64]
    """The maps (I, 3, 4) from world space to the shape's, or to the group's with its centre as the origin."""
    label: NDArray[np.uint32]
    """Word 12 of the records, (I,)."""
    detail: NDArray[np.uint32]
    """The kind of a shape, or the root of the group's tree, (I,)."""
    side: NDArray[np.float32]
    """-1 for shapes with flipped normals, else 1, (I,)."""

    def write(
        self, words: NDArray[np.uint32], at: NDArray[np.uint32], of: NDArray[np.int32], center: NDArray[np.float32]
    ) -> None:
        count = len(self.triangles.corners)
        plain = of < count
        self.triangles.write(words, at[plain], of[plain], center)
        at, placed = at[~plain], of[~plain] - count
        matrix = self.inverse[placed].copy()
        # In kernels the tree's centre is the origin of coordinates.
        matrix[:, :, 3] += matrix[:, :, :3] @ center.astype(np.float64)
        words[at, :12] = matrix.reshape(-1, 12).astype(np.float32).view(np.uint32)
        words[at, 12] = self.label[placed]
        words[at, 13] = self.detail[placed]
        words[at, 14] = self.side[placed].view(np.uint32)
