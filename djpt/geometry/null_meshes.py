"""Invisible meshes, and the media on both sides of their triangles, as the records of a tree tell them.

A tree numbers media from 1 on, in the order in which its meshes name them; 0 is the vacuum. So the records don't depend
on what media are made of, nor on which media a view of the scene follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.calls.layout import BOUNDS, MEDIA, MEDIUM_BITS, PASSABLE

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["NullMeshes"]


class NullMeshes:
    """The meshes among some that light passes straight through, unchanged."""

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        """Number the media of invisible meshes."""
        self._meshes = meshes
        passable = [mesh for mesh in meshes if mesh.bsdf().says("invisible")]
        self.count = len(passable)
        """The number of invisible meshes."""
        sides = [m for mesh in passable for m in (mesh.interior_medium(), mesh.exterior_medium()) if m is not None]
        self.media: list[Any] = list({id(medium): medium for medium in sides}.values())
        """The media on their sides."""
        self.key = [*(self._way(mesh) for mesh in meshes), *(id(medium) for medium in self.media)]
        """Equal if the same meshes of a scene have the same ways through them."""

    @property
    def can_be_measured(self) -> bool:
        """Whether a search can tell the lengths of rays through the media."""
        return self.count > 0 and len(self.media) <= MEDIA

    def ways(self) -> NDArray[np.uint32] | None:
        """The way through each triangle, (F,); None if no search could use it."""
        if not self.can_be_measured:
            return None
        parts = [np.full(len(mesh.indices), self._way(mesh), np.uint32) for mesh in self._meshes]
        for part, mesh in zip(parts, self._meshes, strict=True):
            if part.size and part[0] & BOUNDS:
                turned = faces_inward(mesh)
                part[turned] = exchanged(part[turned])
        return np.concatenate(parts)

    def _way(self, mesh: Mesh) -> int:
        """The way through the triangles of a mesh whose normals point outward."""
        if not mesh.bsdf().says("invisible"):
            return 0
        if not mesh.is_medium_transition():
            return PASSABLE
        return (
            PASSABLE
            | BOUNDS
            | self._number(mesh.interior_medium()) << MEDIUM_BITS
            | self._number(mesh.exterior_medium())
        )

    def _number(self, medium: Any) -> int:
        return 0 if medium is None else 1 + next(i for i, other in enumerate(self.media) if other is medium)


def exchanged(ways: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The ways through triangles whose inside is the outside."""
    bits, number = np.uint32(MEDIUM_BITS), np.uint32((1 << MEDIUM_BITS) - 1)
    inside, outside = (ways >> bits) & number, ways & number
    return (ways & np.uint32(PASSABLE | BOUNDS)) | (outside << bits) | inside


def faces_inward(mesh: Mesh) -> NDArray[np.bool_]:
    """A mask of the triangles whose normals point to the inside, (F,).

    Vertex normals say where the outside is; a mirroring transform turns the others round: see
    `djpt.scene.media_placement`. Those of all corners decide together.
    """
    if mesh.normals is None:
        return np.zeros(len(mesh.indices), np.bool_)
    a, b, c = (mesh.positions[mesh.indices[:, k]] for k in range(3))
    shading = mesh.normals[mesh.indices].sum(axis=1)
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), shading) < 0)
