"""The base of shapes that read a mesh from a file."""

from __future__ import annotations

import copy
from collections.abc import Hashable
from pathlib import Path
from typing import ClassVar

from djpt.core.files import read_bytes
from djpt.description.files import read_once, resolve
from djpt.description.properties import Properties
from djpt.errors import FileError, SceneError
from djpt.shapes.mesh import Mesh
from djpt.shapes.meshes.data import MeshData

__all__ = ["MeshFile"]


class MeshFile(Mesh):
    """A mesh read from a file.

    Parameters: `filename`; `face_normals` (default false: without normals in the file, angle-weighted
    vertex normals are computed), `flip_normals` (default false), `flip_tex_coords` (v becomes 1 - v),
    `to_world`.
    """

    flips_texcoords: ClassVar[bool] = False
    """The default of `flip_tex_coords`."""

    def __init__(self, props: Properties) -> None:
        path = self.find(props)
        form = (type(self), self.part(props))
        where = f"{props.node}: {path.name}"
        read = read_once(props.string("filename"), form, lambda: self.read(self.load(props, path), where, props))
        # A copy of its own: the arrays may be shared, but aren't changed in place.
        data = copy.copy(read)
        data.attributes = dict(read.attributes)
        if props.boolean("flip_tex_coords", self.flips_texcoords) and data.texcoords is not None:
            data.texcoords = data.texcoords.copy()
            data.texcoords[:, 1] = 1 - data.texcoords[:, 1]
        self.adopt(data, props, compute_normals=True, source=path.name)

    @staticmethod
    def find(props: Properties) -> Path:
        """The file that `filename` names."""
        try:
            return resolve(props.string("filename"))
        except FileError as error:
            raise SceneError(f"{props.node}: 'filename': {error}") from None

    def part(self, props: Properties) -> Hashable:
        """What tells apart the meshes that one file may hold; by default it holds one."""
        return None

    @staticmethod
    def load(props: Properties, path: Path) -> bytes:
        """The file's contents."""
        try:
            return read_bytes(path)
        except FileError as error:
            raise SceneError(f"{props.node}: {error}") from None

    def read(self, data: bytes, where: str, props: Properties) -> MeshData:
        """The mesh in a file's contents, in object space; `where` names the file in messages."""
        raise NotImplementedError
