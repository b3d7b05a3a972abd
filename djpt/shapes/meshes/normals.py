"""Normals and areas of triangles, and vertex normals made from them.

A vertex normal is the mean of the normals of the triangles around it, weighted by their angles at the
vertex, so that it doesn't depend on how a surface is cut into triangles: G. Thuermer and C. Wuethrich,
"Computing Vertex Normals from Polygonal Facets", Journal of Graphics Tools 3(1), 1998. Mitsuba does the
same. Sums are taken in double precision, in the order of the faces.

Vectors are kept as three rows, x, y and z, which NumPy works through several times as fast as through triples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from djpt.jit.llvm.host import HostFunctions, Run
from djpt.shapes.meshes.normal_functions import PARAMETERS, add_normal_functions

__all__ = ["CHUNK", "FUNCTIONS", "face_areas", "length", "weighted_normals"]

FUNCTIONS = HostFunctions(add_normal_functions, PARAMETERS, small=4096, few=64)
"""The functions for many triangles, or many meshes; NumPy does the rest, with the same results to the last bit."""

CHUNK = 1 << 13
"""Triangles that are handled at a time: what is computed on the way stays in a core's own cache."""

Rows = NDArray[np.float64]
"""Vectors, (3, N)."""


def face_areas(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> NDArray[np.float64]:
    """The areas of triangles, (F,) float64; NaN or infinite where a corner is."""
    result = np.empty(len(indices))
    run = FUNCTIONS.for_size(len(indices))
    if run is not None:
        run("areas", floats(positions), np.ascontiguousarray(indices), result, 0, len(indices))
        return result
    points = positions.T.astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        for start in range(0, len(indices), CHUNK):
            part = slice(start, start + CHUNK)
            p0, p1, p2 = corners(points, indices[part])
            result[part] = 0.5 * length(cross(p1 - p0, p2 - p0))
    return result


def weighted_normals(positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> NDArray[np.float32]:
    """The unit normals of all vertices, (V, 3) float32; zero for vertices without triangles."""
    run = FUNCTIONS.for_size(len(indices))
    if run is not None:
        return compiled_normals(run, floats(positions), np.ascontiguousarray(indices))
    points = positions.T.astype(np.float64)
    total = np.zeros(points.shape)
    for start in range(0, len(indices), CHUNK):
        add_normals(total, points, indices[start : start + CHUNK])
    return np.ascontiguousarray(normalised(total).T, np.float32)


def compiled_normals(run: Run, positions: NDArray[np.float32], indices: NDArray[np.uint32]) -> NDArray[np.float32]:
    """Do what `weighted_normals` does by compiled functions; the arc cosine remains NumPy's."""
    totals, result = np.zeros(positions.shape), np.empty(positions.shape, np.float32)
    size = min(CHUNK, len(indices))
    normals, angles = np.empty((size, 3)), np.empty(3 * size)
    for start in range(0, len(indices), CHUNK):
        end = min(start + CHUNK, len(indices))
        run("corner_cosines", positions, indices, normals, angles, start, end)
        used = angles[: 3 * (end - start)]
        np.arccos(np.clip(used, -1, 1, out=used), out=used)
        run("add_normals", indices, normals, angles, totals, start, end)
    run("unit_normals", totals, result, len(totals))
    return result


def floats(positions: NDArray[np.float32]) -> NDArray[np.float32]:
    """The numbers as compiled functions read them."""
    return np.ascontiguousarray(positions, np.float32)


def add_normals(total: Rows, points: Rows, indices: NDArray[np.uint32]) -> None:
    """Add the weighted normals of some triangles to their vertices."""
    p = corners(points, indices)
    normals = normalised(cross(p[1] - p[0], p[2] - p[0]))
    edges = [normalised(p[(k + 1) % 3] - p[k]) for k in range(3)]
    for k in range(3):
        cos = -dot(edges[k], edges[(k + 2) % 3])
        weighted = normals * np.arccos(np.clip(cos, -1, 1))
        at = indices[:, k].astype(np.intp)
        for axis in range(3):
            np.add.at(total[axis], at, weighted[axis])


def corners(points: Rows, indices: NDArray[np.uint32]) -> list[Rows]:
    """The three corners of triangles."""
    return [points[:, indices[:, k]] for k in range(3)]


def cross(a: Rows, b: Rows) -> Rows:
    """The cross products."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def dot(a: Rows, b: Rows) -> NDArray[np.float64]:
    """The scalar products."""
    product: NDArray[np.float64] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def length(v: Rows) -> NDArray[np.float64]:
    """The lengths."""
    return np.sqrt(dot(v, v))


def normalised(v: Rows) -> Rows:
    """Scale vectors to length 1; zero stays."""
    size = length(v)
    return np.divide(v, size, out=np.zeros_like(v), where=size > 0)
