"""The data of a mesh, on the host."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.shapes.meshes.normals import CHUNK, length, weighted_normals

__all__ = ["MeshData", "unit"]


@dataclass
class MeshData:
    """Vertices and triangles, with their normals, texture coordinates and attributes."""

    positions: NDArray[np.float32]
    """The vertices, (V, 3)."""
    indices: NDArray[np.uint32]
    """The corners of each triangle, (F, 3), counter-clockwise as seen from the side of its normal."""
    normals: NDArray[np.float32] | None = None
    """The vertex normals, (V, 3), of unit length; zero where the triangle's own normal is to be used."""
    texcoords: NDArray[np.float32] | None = None
    """The texture coordinates, (V, 2)."""
    attributes: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """Attributes by name: (V, C) for names that begin with ``vertex_``, (F, C) for ``face_``."""

    def transform(self, to_world: ScalarTransform4f) -> None:
        """Move to world space; normals are transformed by the inverse transpose and keep their side."""
        matrix = to_world.matrix
        if to_world.is_identity:
            return
        # `clean` finds and reports what overflows to infinity.
        with np.errstate(over="ignore", invalid="ignore"):
            self.positions = (self.positions @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
            if self.normals is not None:
                self.normals = unit(self.normals @ np.linalg.inv(matrix[:3, :3]))

    def compute_normals(self) -> None:
        """Give every vertex the angle-weighted mean of the normals around it."""
        self.normals = weighted_normals(self.positions, self.indices)


def unit(vectors: NDArray[np.floating]) -> NDArray[np.float32]:
    """Scale vectors (N, 3) to length 1; those without a direction become zero."""
    result = np.zeros(vectors.shape, np.float32)
    for start in range(0, len(vectors), CHUNK):
        rows = vectors[start : start + CHUNK].T.astype(np.float64)
        size = length(rows)
        usable = np.isfinite(size) & (size > 0)
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=usable)
        result[start : start + CHUNK] = np.where(usable, rows * scale, 0.0).T
    return result
