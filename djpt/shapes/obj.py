"""Meshes in Wavefront OBJ files."""

from __future__ import annotations

from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.shapes.mesh import MeshFile
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.meshes.obj import read_obj

__all__ = ["Obj"]


class Obj(MeshFile):
    """A mesh from an OBJ file; see `MeshFile` for the parameters; `flip_tex_coords` is true by default."""

    in_any_frame = True
    flips_texcoords = True

    def read(self, data: bytes, where: str, props: Properties) -> MeshData:
        return read_obj(data, where)


register_shape("obj", Obj)
