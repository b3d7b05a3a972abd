"""Normal maps: their pixels, and the triangles on which they are mirrored."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.models.model import Part
from djpt.shapes.meshes.data import MeshData

__all__ = ["halves", "normals_of"]


def halves(part: Part, uv_set: str | None) -> list[tuple[Part, bool]]:
    """The triangles of a part whose normal map isn't mirrored, and those whose is: such maps tell left from right.

    Args:
        part: a part whose mesh has no attributes of its own yet.
        uv_set: the texture coordinates of the normal map, a key of `Part.coordinates`; None without one.
    """
    uv = None if uv_set is None else part.coordinates.get(uv_set)
    if uv is None:
        return [(part, False)]
    mesh = part.mesh
    a, b, c = (uv[mesh.indices[:, i]] for i in range(3))
    u, v = b - a, c - a
    mirrored = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0  # v points down in images
    share = float(mirrored.mean())
    if share in (0.0, 1.0):
        return [(part, share == 1)]
    found = []
    for side in (False, True):
        used, indices = np.unique(mesh.indices[mirrored == side], return_inverse=True)
        own = MeshData(mesh.positions[used], indices.reshape(-1, 3).astype(np.uint32))
        own.normals = None if mesh.normals is None else mesh.normals[used]
        values = (part.coordinates, part.tints)
        coordinates, tints = ({name: rows[used] for name, rows in each.items()} for each in values)
        half = replace(part, mesh=own, places=list(part.places), coordinates=coordinates, tints=tints)
        found.append((half, side))
    return found


def normals_of(pixels: NDArray[np.uint8], strength: float, mirrored: bool) -> NDArray[Any]:
    """The pixels of a normal map, stronger or weaker, and turned over for triangles with a mirrored texture."""
    result = np.ascontiguousarray(pixels[..., :3])
    if strength != 1:
        xy = np.clip((result[..., :2] / 127.5 - 1) * strength, -1, 1)
        result[..., :2] = np.rint((xy + 1) * 127.5)
    if mirrored:
        result = result.copy()
        result[..., 1] = 255 - result[..., 1]
    return result
