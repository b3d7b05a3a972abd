"""The normals at the vertices of a mesh that moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr

from djpt.jit.types import Float, Normal3f, Point3f, UInt32
from djpt.shapes.silhouettes.moving import attached_place, exchanged_value

__all__ = ["attached_normals", "with_normals"]

NAME = "vertex_normals"


def attached_normals(mesh: Any) -> Float:
    """The normals, attached to the positions of the vertices."""
    known = exchanged_value(mesh, NAME)
    return vertex_normals(attached_place(mesh), mesh.faces_parameter) if known is None else known


def with_normals(values: Mapping[tuple[int, str], Any], shapes: Sequence[Any]) -> dict[tuple[int, str], Any]:
    """The variables that shapes move by, and the normals that follow from them: loops can't sum them up.

    Args:
        values: variables for `djpt.shapes.silhouettes.moving.exchanged`.
        shapes: the shapes of the scene.
    """
    result = dict(values)
    for shape in shapes:
        positions = values.get((id(shape), "vertex_positions"))
        if positions is not None and shape.has_vertex_normals():
            with dr.resume_grad():
                result[id(shape), NAME] = vertex_normals(positions, shape.faces_parameter)
    dr.eval(result)
    return result


def vertex_normals(positions: Float, faces: UInt32) -> Float:
    """The normals at vertices, as `djpt.shapes.meshes.normals` computes them, attached to the positions."""
    corner = [dr.gather(UInt32, faces, 3 * dr.arange(UInt32, dr.width(faces) // 3) + k) for k in range(3)]
    p = [dr.gather(Point3f, positions, k) for k in corner]
    n = dr.normalize(dr.cross(p[1] - p[0], p[2] - p[0]))
    total = dr.zeros(Normal3f, dr.width(positions) // 3)
    for k in range(3):
        d1, d2 = dr.normalize(p[(k + 1) % 3] - p[k]), dr.normalize(p[(k + 2) % 3] - p[k])
        dr.scatter_add(total, n * dr.safe_acos(dr.dot(d1, d2)), corner[k])
    flat: Any = dr.ravel(dr.normalize(total))
    return Float(flat)
