"""Normals and areas of triangles, and vertex normals made from them.

A vertex normal is the mean of the normals of the triangles around it, weighted by their angles at the
vertex, so that it doesn't depend on how a surface is cut into triangles: G. Thuermer and C. Wuethrich,
"Computing Vertex Normals from Polygonal Facets", Journal of Graphics Tools 3(1), 1998. Mitsuba does the
same. Sums are taken in double precision, in the order of the faces.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["face_areas", "face_crosses", "weighted_normals"]

CHUNK = 1 << 18
"""Triangles that are handled at a time: bounds temporary memory."""


def face_crosses(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> NDArray[np.float64]:
    """(p1 - p0) x (p2 - p0) of each triangle: twice its area along its normal, (F, 3) float64."""
    p0, p1, p2 = (positions[indices[:, k]].astype(np.float64) for k in range(3))
    return cross(p1 - p0, p2 - p0)


def face_areas(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> NDArray[np.float64]:
    """The areas of triangles, (F,) float64."""
    result = np.empty(len(indices))
    for start in range(0, len(indices), CHUNK):
        part = slice(start, start + CHUNK)
        result[part] = 0.5 * length(face_crosses(positions, indices[part]))
    return result


def weighted_normals(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> NDArray[np.float32]:
    """The unit normals of all vertices, (V, 3) float32; zero for vertices without triangles."""
    total = np.zeros((len(positions), 3))
    for start in range(0, len(indices), CHUNK):
        add_normals(total, positions, indices[start : start + CHUNK])
    size = length(total)
    return np.divide(total, size[:, None], out=np.zeros_like(total), where=size[:, None] > 0).astype(np.float32)


def add_normals(total: NDArray[np.float64], positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> None:
    """Add the weighted normals of some triangles to their vertices."""
    corners = [positions[indices[:, k]].astype(np.float64) for k in range(3)]
    normals = normalised(cross(corners[1] - corners[0], corners[2] - corners[0]))
    edges = [normalised(corners[(k + 1) % 3] - corners[k]) for k in range(3)]
    for k in range(3):
        cos = -np.einsum("ij,ij->i", edges[k], edges[(k + 2) % 3])
        weighted = normals * np.arccos(np.clip(cos, -1, 1))[:, None]
        for axis in range(3):
            total[:, axis] += np.bincount(indices[:, k], weighted[:, axis], len(total))


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The cross products of rows; several times faster than `numpy.cross`."""
    result = np.empty_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        result[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return result


def length(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """The lengths of rows."""
    result: NDArray[np.float64] = np.sqrt(np.einsum("ij,ij->i", v, v))
    return result


def normalised(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale rows to length 1; zero rows stay."""
    size = length(v)[:, None]
    return np.divide(v, size, out=np.zeros_like(v), where=size > 0)
