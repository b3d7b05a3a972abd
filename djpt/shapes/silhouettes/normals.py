"""What shapes move by as loops read it, and the normals of meshes that follow from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr

from djpt.jit.types import Float, Float64, Matrix4f, Normal3f, Point3f, UInt32
from djpt.shapes.silhouettes.base import with_gradient
from djpt.shapes.silhouettes.moving import attached_place, exchanged_value, motion_name

__all__ = ["attached_normals", "with_normals"]

NAME = "vertex_normals"


def attached_normals(mesh: Any) -> Float | Float64:
    """The normals, attached to the positions of the vertices."""
    known = exchanged_value(mesh, NAME)
    return following(mesh, attached_place(mesh)) if known is None else known


def following(mesh: Any, positions: Float) -> Float:
    """The normals of a mesh as they are, attached to the positions as if they were computed from these."""
    normals: Float = with_gradient(mesh.vertex_normals, vertex_normals(positions, mesh.faces_parameter))
    return normals


def with_normals(values: Mapping[tuple[int, str], Any], shapes: Sequence[Any]) -> dict[tuple[int, str], Any]:
    """The variables that shapes move by, and the normals that follow from them: loops can't sum them up.

    They are in memory, in double precision, and so are the sums of their gradients, which many lanes add to.

    Args:
        values: variables for `djpt.shapes.silhouettes.moving.exchanged`.
        shapes: the shapes of the scene.
    """
    result = dict(values)
    for shape in shapes:
        key = id(shape), motion_name(shape)
        place = values.get(key)
        if place is None:
            continue
        with dr.resume_grad():
            result[key] = in_memory(place)
            if shape.of_triangles and shape.has_vertex_normals():
                result[id(shape), NAME] = Float64(following(shape, place))
    dr.eval(result)
    return result


def in_memory(place: Any) -> Float64:
    """The entries of a matrix, row by row, or points."""
    if not isinstance(place, Matrix4f):
        return Float64(place)
    entries: Float64 = dr.concat([Float64(place[row, column]) for row in range(4) for column in range(4)])
    return entries


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
