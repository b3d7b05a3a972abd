"""Where surfaces meet in curves: shapes that cut or touch each other, and meshes with flat facets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from djpt.scene.intersecting_shapes import may_intersect

__all__ = ["flat_meshes", "meeting_pairs"]


def meeting_pairs(shapes: Sequence[Any], moving: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
    """The pairs of shapes that may cut or touch each other, of which one is among the `moving`."""
    numbers = {id(shape) for shape in moving}
    moved: list[Any] = []  # of those before
    for i, shape in enumerate(shapes):
        moves = id(shape) in numbers
        for other in shapes[:i] if moves else moved:
            if may_intersect(shape, other):
                yield shape, other
        if moves:
            moved.append(shape)


def flat_meshes(shapes: Sequence[Any]) -> list[Any]:
    """The meshes without interpolated normals whose triangles lie in several planes: their shading jumps at edges."""
    return [shape for shape in shapes if shape.of_triangles and not shape.has_vertex_normals() and is_bent(shape)]


def is_bent(mesh: Any) -> bool:
    """Whether the triangles of a mesh have different normals."""
    corners = np.asarray(mesh.positions, np.float64)[np.asarray(mesh.indices)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = (normals / np.maximum(lengths, 1e-300))[lengths[:, 0] > 0]
    return bool(len(normals) and (normals @ normals[0] < 1 - 1e-6).any())
