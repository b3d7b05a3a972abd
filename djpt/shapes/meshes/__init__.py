"""Triangle meshes on the host: their data, readers, vertex normals, cleaning."""

from djpt.shapes.meshes.data import MeshData

__all__ = ["MeshData"]
