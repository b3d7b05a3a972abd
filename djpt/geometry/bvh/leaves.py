"""The contents of a BVH's leaves: triangles, and shapes and instances that rays reach through a transform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.face_frames import face_frames
from djpt.geometry.mesh_part import MeshPart

__all__ = ["MixedLeaves", "PlacedLeaves", "TriangleLeaves"]


@dataclass
class TriangleLeaves:
    """Triangles as leaves; the first axis of all arrays is the face."""

    corners: NDArray[np.float32]
    """The corners, (F, 3, 3): face, corner, axis."""
    label: NDArray[np.uint32]
    """Word 12 of the records, (F,)."""
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
        words[at, 12] = self.label[of]
        words[at, 13] = of + self.first_face
        words[at, 14:] = self.direction[of].view(np.uint32)

    @staticmethod
    def of(part: MeshPart) -> TriangleLeaves:
        """The triangles of some meshes."""
        corners = part.corners()
        return TriangleLeaves(corners, part.label_of_face(), *face_frames(part.meshes, corners), part.first_face)


@dataclass
class PlacedLeaves:
    """Leaves with a transform: analytic shapes and instances; the first axis of all arrays is the leaf."""

    inverse: NDArray[np.float64]
    """The maps (P, 3, 4) from world space to the shape's, or to the group's with its centre as the origin."""
    label: NDArray[np.uint32]
    """Word 12 of the records, (P,)."""
    detail: NDArray[np.uint32]
    """The kind of a shape, or where the group's tree begins, (P,)."""
    side: NDArray[np.float32]
    """-1 for shapes with flipped normals, else 1; of pieces the first radius, (P,)."""
    last: NDArray[np.float32]
    """Of pieces the last radius, (P,)."""

    def write(
        self, words: NDArray[np.uint32], at: NDArray[np.uint32], of: NDArray[np.int32], center: NDArray[np.float32]
    ) -> None:
        matrix = self.inverse[of].copy()
        # In kernels the tree's centre is the origin of coordinates.
        matrix[:, :, 3] += matrix[:, :, :3] @ center.astype(np.float64)
        words[at, :12] = matrix.reshape(-1, 12).astype(np.float32).view(np.uint32)
        words[at, 12] = self.label[of]
        words[at, 13] = self.detail[of]
        words[at, 14] = self.side[of].view(np.uint32)
        words[at, 15] = self.last[of].view(np.uint32)

    @staticmethod
    def joined(parts: Sequence[PlacedLeaves]) -> PlacedLeaves:
        """The leaves of all parts, in order."""
        return PlacedLeaves(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(PlacedLeaves)))


@dataclass
class MixedLeaves:
    """Triangles first, then leaves with a transform."""

    triangles: TriangleLeaves
    placed: PlacedLeaves

    def write(
        self, words: NDArray[np.uint32], at: NDArray[np.uint32], of: NDArray[np.int32], center: NDArray[np.float32]
    ) -> None:
        count = len(self.triangles.corners)
        plain = of < count
        self.triangles.write(words, at[plain], of[plain], center)
        self.placed.write(words, at[~plain], of[~plain] - np.int32(count), center)
