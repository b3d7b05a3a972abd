"""The check whether a mesh can be rendered: errors for broken data, one warning for harmless defects."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError
from djpt.shapes.meshes.data import MeshData, unit
from djpt.shapes.meshes.normals import face_areas

__all__ = ["check_indices", "clean"]

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
