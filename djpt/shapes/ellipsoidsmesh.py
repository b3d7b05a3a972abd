"""Clouds of ellipsoids as meshes: a shell of triangles about each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.shapes.ellipsoid_cloud import Cloud
from djpt.shapes.mesh import Mesh
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.mitsuba_api import ShapeType

__all__ = ["EllipsoidsMesh"]

Vertices = NDArray[np.float64]
Faces = NDArray[np.uint32]


class EllipsoidsMesh(Cloud, Mesh):
    """Ellipsoids in shells of triangles, which enclose them and are visible only from outside.

    Parameters: those of `djpt.shapes.ellipsoids.Ellipsoids`, and `shell`: "ico_sphere" (20 triangles, default), "box"
    (12), "uv_sphere" (72), or a mesh. A shell is scaled until no vertex and no middle of a triangle lies within the
    unit sphere. `si.prim_index` is the number of the ellipsoid; uv are barycentric.
    """

    in_any_frame = True
    shape_kind = ShapeType.EllipsoidsMesh
    one_sided = True

    def __init__(self, props: Properties) -> None:
        self.shell = shell_of(props)
        nothing = MeshData(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
        self.adopt(nothing, props, compute_normals=False, checked=False)
        self.read_cloud(props)
        self.faces_per_primitive = len(self.shell[1])
        self._wrap()

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        Cloud.traverse_geometry(self, callback)

    def check_parameter(self, name: str, value: Any) -> Any:
        return Cloud.check_parameter(self, name, value)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        Cloud.parameters_changed(self, keys)
        if "data" in keys:
            self._wrap()

    def primitive_count(self) -> int:
        return len(self.indices)

    def _wrap(self) -> None:
        """Put the shells about the ellipsoids."""
        vertices, faces = self.shell
        placed = self._table()[:, None, :3] + np.einsum("nij,vj->nvi", self._half_axes(), vertices)
        first = np.arange(self.count, dtype=np.uint32)[:, None, None] * np.uint32(len(vertices))
        self.positions = np.ascontiguousarray(placed.reshape(-1, 3), np.float32)
        self.indices = np.ascontiguousarray((faces[None] + first).reshape(-1, 3), np.uint32)
        self._forget()
        self._measure()


def shell_of(props: Properties) -> tuple[Vertices, Faces]:
    """The shell that is asked for, scaled so that it encloses the unit sphere."""
    given = props.raw("shell", "ico_sphere")
    if isinstance(given, Mesh):
        vertices, faces = given.positions.astype(np.float64), given.indices
    else:
        vertices, faces = SHELLS[props.string("shell", "ico_sphere", choices=SHELLS)]()
    corners = vertices[faces]
    least = min(np.linalg.norm(corners, axis=2).min(), np.linalg.norm(corners.mean(axis=1), axis=1).min())
    if least <= 0:
        raise props.error("shell", "must enclose the origin")
    return vertices / least, faces


def box() -> tuple[Vertices, Faces]:
    """The cube [-1, 1]^3, its triangles turned outwards."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.uint32)


def rings(polar: Sequence[float], count: int, starts: Sequence[float]) -> tuple[Vertices, Faces]:
    """Rings of `count` points about the y axis at polar angles, from given azimuths, between the poles."""
    points = [[0.0, math.cos(0), 0.0]]
    for theta, start in zip(polar, starts, strict=True):
        for k in range(count):
            phi = start + 2 * math.pi * k / count
            points.append([math.sin(theta) * math.cos(phi), math.cos(theta), math.sin(theta) * math.sin(phi)])
    points.append([0.0, -1.0, 0.0])
    faces, last = [], len(points) - 1
    for k in range(count):
        following = (k + 1) % count
        faces.append((0, 1 + following, 1 + k))
        for ring in range(len(polar) - 1):
            above, below = 1 + ring * count, 1 + (ring + 1) * count
            faces += [(above + k, above + following, below + k), (above + following, below + following, below + k)]
        faces.append((last, last - count + k, last - count + following))
    return np.array(points), np.array(faces, np.uint32)


def ico_sphere() -> tuple[Vertices, Faces]:
    """The icosahedron with two vertices on the y axis."""
    tilt = math.atan(2)
    return rings((tilt, math.pi - tilt), 5, (0.0, math.pi / 5))


def uv_sphere() -> tuple[Vertices, Faces]:
    """Four rings of nine points, and the poles."""
    start = math.radians(-50)
    return rings([math.radians(36 * (k + 1)) for k in range(4)], 9, [start] * 4)


SHELLS = {"ico_sphere": ico_sphere, "box": box, "uv_sphere": uv_sphere}
SHELLS["default"] = ico_sphere

register_shape("ellipsoidsmesh", EllipsoidsMesh)
