"""The meshes that one tree of a scene is built over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["MeshPart"]


@dataclass
class MeshPart:
    """Meshes that follow each other in a `MeshSet`."""

    meshes: Sequence[Mesh]
    labels: NDArray[np.uint32]
    """The label of each mesh: see `djpt.geometry.bvh.steps.records`."""
    first_face: int
    """The set-wide number of the first triangle."""

    @property
    def face_count(self) -> int:
        """The number of triangles."""
        return sum(len(mesh.indices) for mesh in self.meshes)

    def corners(self) -> NDArray[np.float32]:
        """All triangles in world space, (F, 3, 3): face, corner, axis."""
        result = np.empty((self.face_count, 3, 3), np.float32)
        first = 0
        for mesh in self.meshes:
            end = first + len(mesh.indices)
            np.take(mesh.positions, mesh.indices, axis=0, out=result[first:end], mode="clip")
            first = end
        return result

    def label_of_face(self) -> NDArray[np.uint32]:
        """The label of each triangle, (F,)."""
        return np.repeat(self.labels, [len(mesh.indices) for mesh in self.meshes])
