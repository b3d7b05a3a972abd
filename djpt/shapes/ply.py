"""Meshes in PLY files."""

from __future__ import annotations

from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.shapes.mesh import MeshFile
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.meshes.ply import read_ply

__all__ = ["Ply"]


class Ply(MeshFile):
    """A mesh from a PLY file, ascii or binary; see `MeshFile` for the parameters.

    Normals ``nx, ny, nz`` and texture coordinates ``u, v`` or ``s, t`` are read, and attributes of
    vertices and faces: see `djpt.shapes.meshes.ply.read_ply`.
    """

    in_any_frame = True

    def read(self, data: bytes, where: str, props: Properties) -> MeshData:
        return read_ply(data, where)


register_shape("ply", Ply)
