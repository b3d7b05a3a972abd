"""The frame of each triangle, computed once on the host.

A path tracer needs the normal and the direction of dp/du at every vertex of a path. Both are the
same all over a triangle, so its record holds them, and shading needs no corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh


__all__ = ["face_frames"]

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
