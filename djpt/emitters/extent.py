"""Size, brightness and curvature of what shines: numbers on the host."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_array
from djpt.errors import SceneError
from djpt.shapes import Shape
from djpt.textures import Texture

__all__ = ["area_of", "mean_of", "normals_of", "number", "require_area"]

Vector = NDArray[np.float64]


def number(value: Any) -> float:
    """The number in an array of width 1."""
    return float(as_array(dr.detach(value)))


def mean_of(texture: Texture) -> float:
    """The average of a texture over uv and colours."""
    return number(texture.mean())


def area_of(shape: Shape, scene: tuple[Vector, Vector]) -> float:
    """The area of a shape; if unknown, that of the box about its part in the box `scene`."""
    if shape.has_area:
        return number(shape.surface_area())
    low, high = shape.world_box()
    x, y, z = np.maximum(np.minimum(high, scene[1]) - np.maximum(low, scene[0]), 0)
    return float(2 * (x * y + y * z + z * x))


def require_area(shape: Shape) -> None:
    """Raise `SceneError` if no points can be drawn on a shape."""
    if not shape.has_area:
        raise SceneError(f"{shape.id()}: no rays can be drawn from this shape, since its area is unknown")


def normals_of(shape: Shape) -> tuple[Vector, float]:
    """A cone that holds a shape's normals: its axis, and the angle between axis and side in radians."""
    if shape.plane() is not None and hasattr(shape, "normal"):
        return as_array(dr.detach(shape.normal)), 0.0
    if shape.of_triangles:
        normals = mesh_normals(shape)
        axis = normals.sum(axis=0)
        length = float(np.linalg.norm(axis))
        if length > 1e-3 * len(normals):
            axis /= length
            return axis, math.acos(min(max(float((normals @ axis).min()), -1.0), 1.0))
    return np.array([0.0, 0.0, 1.0]), math.pi


def mesh_normals(mesh: Any) -> Vector:
    """Unit normals of all faces, and of all vertices if they have any: (N, 3)."""
    a, b, c = np.moveaxis(mesh.positions.astype(np.float64)[mesh.indices], 1, 0)
    normals = np.cross(b - a, c - a)
    if mesh.normals is not None:
        normals = np.concatenate([normals, mesh.normals])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = (normals / np.where(lengths > 0, lengths, 1))[lengths[:, 0] > 0]
    return -normals if mesh.flip_normals else normals
