"""The input of a BVH: the meshes of a part of the scene, and the contents of leaves.

Leaves hold triangles, or shapes and instances that rays reach through a transform. A path tracer needs the normal and
the direction of dp/du at every vertex of a path. Both are the same all over a triangle, so its record holds them, and
shading needs no corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["Extent", "MeshPart", "MixedLeaves", "PlacedLeaves", "TriangleLeaves", "face_frames"]


SLACK = 4e-7
"""The growth of boxes, per unit of the tree's diagonal."""


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
    def slack(self) -> float:
        """By how much boxes grow on each side, to cover the rounding of distances to planes."""
        return SLACK * max(self.diagonal, 1e-30)

    @property
    def scale(self) -> float:
        """1 / the diagonal."""
        return 1 / max(self.diagonal, 1e-30)

    @property
    def area(self) -> float:
        """Half the surface area in units of the squared diagonal."""
        x, y, z = (self.high.astype(np.float64) - self.low) * self.scale
        return float(x * y + y * z + z * x)


@dataclass
class MeshPart:
    """Meshes that follow each other in a `MeshSet`."""

    meshes: Sequence[Mesh]
    labels: NDArray[np.uint32]
    """The label of each mesh: see `djpt.geometry.bvh.steps.records`."""
    first_face: int
    """The set-wide number of the first triangle."""
    ways: NDArray[np.uint32] | None = None
    """The way through each triangle, (F,): see `djpt.geometry.bvh.calls.layout`. None: all are opaque."""

    @property
    def face_count(self) -> int:
        """The number of triangles."""
        return sum(len(mesh.indices) for mesh in self.meshes)

    def corners(self) -> NDArray[np.float32]:
        """All triangles in world space, (F, 3, 3): face, corner, axis."""
        result = np.empty((self.face_count, 3, 3), np.float32)
        first = 0
        for mesh in self.meshes:
            end = first + len(mesh.indices)
            np.take(mesh.positions, mesh.indices, axis=0, out=result[first:end], mode="clip")
            first = end
        return result

    def label_of_face(self) -> NDArray[np.uint32]:
        """The label of each triangle, (F,)."""
        return np.repeat(self.labels, [len(mesh.indices) for mesh in self.meshes])


# ---- leaves ------------------------------------------------------------------------------------------------------


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
    """The directions of dp/du, (F, 2), see `djpt.geometry.bvh.leaves`."""
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


# ---- frames of triangles -----------------------------------------------------------------------------------------


CHUNK = 1 << 17
"""Faces computed at a time: bounds temporary memory."""


def face_frames(
    meshes: Sequence[Mesh], corners: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Unit normals (F, 3), and the direction of dp/du (F, 2) as cosines with the two tangents of the normal.

    The tangents are those of `djpt.core.frame.coordinate_system`. `flip_normals` has been applied.
    """
    normals, directions = np.empty((len(corners), 3), np.float32), np.empty((len(corners), 2), np.float32)
    first = 0
    for mesh in meshes:
        for begin in range(0, len(mesh.indices), CHUNK):
            indices = mesh.indices[begin : begin + CHUNK]
            part = slice(first + begin, first + begin + len(indices))
            p = corners[part]
            edge1, edge2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
            n = unit(np.cross(edge1, edge2))
            n = -n if mesh.flip_normals else n
            s, t = tangents(n)
            dp_du = edge1
            if mesh.texcoords is not None:
                uv = mesh.texcoords[indices]
                d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
                determinant = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
                solved = (d2[:, 1:] * edge1 - d1[:, 1:] * edge2) * np.sign(determinant)[:, None]
                dp_du = np.where(determinant[:, None] != 0, solved, s)
            direction = np.stack([row_dot(dp_du, s), row_dot(dp_du, t)], axis=1)
            length = np.linalg.norm(direction, axis=1, keepdims=True)
            usable = length > 0
            directions[part] = np.where(usable, direction / np.where(usable, length, 1), [1, 0])
            normals[part] = n
        first += len(mesh.indices)
    return normals, directions


def row_dot(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Dot products row by row."""
    return np.einsum("ij,ij->i", a, b)


def unit(v: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows of unit length; +z for zeros."""
    length = np.linalg.norm(v.astype(np.float64), axis=1, keepdims=True)
    usable = length > 0
    return np.where(usable, v / np.where(usable, length, 1), [0, 0, 1]).astype(np.float32)


def tangents(n: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """`djpt.core.frame.coordinate_system` on the host; as in kernels, -0 is no negative number."""
    x, y, z = n.T
    sign = np.where(z < 0, np.float32(-1), np.float32(1))
    a = -1 / (sign + z)
    b = x * y * a
    s = np.stack([sign * x * x * a + 1, sign * b, -sign * x], axis=1)
    return s, np.stack([b, y * y * a + sign, -y], axis=1)
