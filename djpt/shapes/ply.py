"""Meshes in PLY files."""

from __future__ import annotations

import copy

from djpt.core.numeric import describe
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.shapes.mesh import MeshFile
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.meshes.ply import read_ply

__all__ = ["Ply"]


class Ply(MeshFile):
    """A mesh from a PLY file, ascii or binary; see `MeshFile` for the parameters.

    Normals ``nx, ny, nz`` and texture coordinates ``u, v`` or ``s, t`` are read, and attributes of
    vertices and faces: see `djpt.shapes.meshes.ply.read_ply`. In place of `filename`, `data` may be the contents of
    such a file that were made in Python, a `djpt.shapes.meshes.data.MeshData`.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        if "data" not in props:
            super().__init__(props)
            return
        if "filename" in props:
            raise props.error("data", "and 'filename' give the same thing: give only one")
        given = props.raw("data")
        if not isinstance(given, MeshData):
            raise props.error("data", f"must be a MeshData, found {describe(given)}")
        # A copy of its own: the arrays may be shared, but aren't changed in place.
        data = copy.copy(given)
        data.attributes = dict(given.attributes)
        if props.boolean("flip_tex_coords", False) and data.texcoords is not None:
            data.texcoords = data.texcoords.copy()
            data.texcoords[:, 1] = 1 - data.texcoords[:, 1]
        self.adopt(data, props, compute_normals=True)

    def read(self, data: bytes, where: str, props: Properties) -> MeshData:
        return read_ply(data, where)


register_shape("ply", Ply)
