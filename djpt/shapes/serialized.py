"""Meshes in Mitsuba's compressed binary format."""

from __future__ import annotations

from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.shapes.mesh import MeshFile
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.meshes.serialized import read_serialized

__all__ = ["Serialized"]


class Serialized(MeshFile):
    """A mesh from a `serialized` file; see `MeshFile` for the parameters.

    `shape_index` (default 0) chooses one of the file's meshes.
    """

    in_any_frame = True

    def part(self, props: Properties) -> int:
        return props.integer("shape_index", 0, low=0)

    def read(self, data: bytes, where: str, props: Properties) -> MeshData:
        return read_serialized(data, where, self.part(props))


register_shape("serialized", Serialized)
