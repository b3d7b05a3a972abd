"""The data of a mesh, on the host, and the check whether it can be rendered: errors for what is broken, or warnings."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.errors import SceneError
from djpt.shapes.meshes.normals import CHUNK, face_areas, length, weighted_normals

__all__ = ["MeshData", "check_indices", "clean", "unit"]


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


SMALLEST = 0.5 * float(np.finfo(np.float32).tiny) ** 0.5
"""The least area: the cross product of the edges has a direction in single precision."""
LEAST_SHARE = 2.0**-48
"""Of a mesh that is tiny as a whole: the least area as a fraction of the largest triangle's."""


def check_indices(indices: NDArray[np.uint32], vertex_count: int, where: str) -> None:
    """Raise `SceneError` for the first triangle that names a vertex which doesn't exist."""
    if len(indices) and int(indices.max()) >= vertex_count:
        face = int(np.argmax((indices >= vertex_count).any(axis=1)))
        worst = int(indices[face].max())
        raise SceneError(f"{where}: face {face} refers to vertex {worst}; there are {vertex_count}, counted from 0")


def clean(data: MeshData, where: str) -> NDArray[np.float64]:
    """Drop triangles that have no area or a corner at infinity or NaN, in place and with one warning.

    Such triangles can't be hit, and have no normal. Vertices keep their numbers.

    Args:
        data: in world space.
        where: names the mesh in messages.

    Returns:
        The areas of the triangles that stay, (F,).

    Raises:
        SceneError: an index is out of range, or nothing is left.
    """
    if not len(data.indices):
        raise SceneError(f"{where}: the mesh is empty: {len(data.positions)} vertices, no triangle")
    check_indices(data.indices, len(data.positions), where)
    finite = np.asarray(np.isfinite(data.positions).all(axis=1))
    lost = np.zeros(len(data.indices), np.bool_)
    if not finite.all():
        lost |= ~finite[data.indices].all(axis=1)
    areas = face_areas(data.positions, data.indices)
    # Also false for NaN.
    largest = float(areas.max(initial=0.0, where=np.isfinite(areas)))
    flat = ~((areas >= min(SMALLEST, LEAST_SHARE * largest)) & (areas > 0)) & ~lost
    if lost.any() or flat.any():
        drop(data, lost, flat, where)
        areas = areas[~(lost | flat)]
    # A vertex that no triangle uses must not disturb the mesh's extent.
    if not finite.all():
        data.positions = np.where(finite[:, None], data.positions, data.positions[data.indices[0, 0]])
    clean_vertex_data(data, where)
    return areas


def drop(data: MeshData, lost: NDArray[np.bool_], flat: NDArray[np.bool_], where: str) -> None:
    """Remove the triangles that are `lost` or `flat`, and warn about it."""
    kept = ~(lost | flat)
    reasons = [
        f"{int(mask.sum())} {what}"
        for mask, what in ((flat, "without area"), (lost, "with a vertex that isn't finite"))
        if mask.any()
    ]
    count = int((~kept).sum())
    if not kept.any():
        raise SceneError(f"{where}: none of the {count} triangles can be rendered: {', '.join(reasons)}")
    first = int(np.argmin(kept))
    warnings.warn(f"{where}: dropped triangles: {', '.join(reasons)}; the first is face {first}", stacklevel=2)
    data.indices = np.ascontiguousarray(data.indices[kept])
    for name, values in data.attributes.items():
        if name.startswith("face_"):
            data.attributes[name] = np.ascontiguousarray(values[kept])


def clean_vertex_data(data: MeshData, where: str) -> None:
    """Make normals unit vectors or zero, and texture coordinates and attributes finite."""
    if data.normals is not None:
        data.normals = unit(data.normals)
    named = {"vertex_texcoords": data.texcoords, **data.attributes}
    for name, values in named.items():
        if values is not None and not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values).all(axis=1)))
            raise SceneError(f"{where}: {name} of {name.split('_')[0]} {row} isn't finite: {values[row].tolist()}")
