"""What the leaves of a BVH hold: triangles, or whole groups of them seen through a transform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.records import LEAF, PORTAL

__all__ = ["InstanceLeaves", "TriangleLeaves"]


@dataclass
class TriangleLeaves:
    """Triangles; (F, ..) arrays."""

    corners: NDArray[np.float32]
    """(F, 3, 3)."""
    mesh: NDArray[np.uint32]
    normal: NDArray[np.float32]
    """(F, 3)."""
    direction: NDArray[np.float32]
    """(F, 2), see `djpt.geometry.face_frames`."""
    first_face: int = 0
    """The number of the first of them."""

    def write(
        self, words: NDArray[np.uint32], at: NDArray[np.uint32], of: NDArray[np.int32], center: NDArray[np.float32]
    ) -> None:
        words[at, :9] = (self.corners[of] - center).reshape(-1, 9).view(np.uint32)
        words[at, 9:12] = self.normal[of].view(np.uint32)
        words[at, 12] = self.mesh[of] | np.uint32(LEAF)
        words[at, 13] = of + self.first_face
        words[at, 14:] = self.direction[of].view(np.uint32)


@dataclass
class InstanceLeaves:
    """Triangles first, instances after them."""

    triangles: TriangleLeaves
    inverse: NDArray[np.float64]
    """(I, 3, 4): from world space to coordinates seen from the centre of the instance's group."""
    root: NDArray[np.uint32]
    """(I,): the root of the group's tree."""

    def write(
        self, words: NDArray[np.uint32], at: NDArray[np.uint32], of: NDArray[np.int32], center: NDArray[np.float32]
    ) -> None:
        count = len(self.triangles.corners)
        plain = of < count
        self.triangles.write(words, at[plain], of[plain], center)
        at, instance = at[~plain], of[~plain] - count
        matrix = self.inverse[instance].copy()
        # Kernels see points from the tree's centre.
        matrix[:, :, 3] += matrix[:, :, :3] @ center.astype(np.float64)
        words[at, :12] = matrix.reshape(-1, 12).astype(np.float32).view(np.uint32)
        words[at, 12] = instance.astype(np.uint32) | np.uint32(LEAF | PORTAL)
        words[at, 13] = self.root[instance]
