"""All triangles of a scene in one BVH, and what their records say about a hit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr

from djpt.geometry.bvh.build import build
from djpt.geometry.bvh.records import LEAF, MESH, WORDS, Records, pack
from djpt.geometry.bvh.search import search
from djpt.geometry.bvh.traversal import NONE, load, triangle_corners
from djpt.geometry.bvh.wide import collapse
from djpt.geometry.mesh_set import MeshSet
from djpt.geometry.surface import Surface
from djpt.geometry.triangle import RayPlane, intersect_triangle
from djpt.lookup import Numbers
from djpt.records import Ray3f
from djpt.types import Bool, Float, Point3f, UInt32, Vector3f

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["Triangles"]


class Triangles:
    """Ray queries against the meshes of a scene. Faces are named by their record in the BVH."""

    def __init__(self, meshes: MeshSet, shapes: Sequence[int]) -> None:
        """`shapes[i]` is the index in the scene of the i-th mesh."""
        self.meshes = meshes
        self._shapes = list(shapes)
        self._shape_of_mesh = Numbers(self._shapes)
        self._first_face = Numbers(meshes.first_face)
        self.records = self._build()

    def _build(self) -> Records:
        corners = self.meshes.corners()
        tree = collapse(build(corners.min(axis=1), corners.max(axis=1)))
        return pack(tree, corners, self.meshes.mesh_of_face())

    def move(self, mesh: Mesh) -> None:
        """A mesh has new vertices or faces."""
        self.meshes.refresh(mesh)
        self.records = self._build()

    # ---- ray queries -----------------------------------------------------------------

    def search(self, ray: Ray3f, any_hit: bool, active: Bool | bool = True) -> tuple[Float, UInt32]:
        """Distance and record of the first hit with 0 < t < maxt, or of any one; NONE on a miss."""
        return search(self.records, ray, any_hit, active)

    def occluded(self, ray: Ray3f, active: Bool | bool) -> Bool:
        """Is there a hit with 0 < t < maxt?"""
        return self.search(ray, True, active)[1] != NONE

    # ---- what a record says --------------------------------------------------------------

    def mesh_of(self, record: UInt32) -> UInt32:
        """The mesh that a triangle belongs to."""
        return dr.gather(UInt32, self.records.words, record * WORDS + 12) & MESH

    def shape_of(self, record: UInt32) -> UInt32:
        """The index of its shape in the scene."""
        return self._shape_of_mesh.at(self.mesh_of(record))

    def per_mesh(self, of_shape: Sequence[int]) -> Numbers:
        """A table of numbers by shape as one by mesh."""
        return Numbers([of_shape[shape] for shape in self._shapes])

    def face_within_mesh(self, record: UInt32) -> UInt32:
        """The number of a triangle in its mesh."""
        face = dr.gather(UInt32, self.records.words, record * WORDS + 13, record != NONE)
        return face - self._first_face.at(self.mesh_of(record))

    def surface(self, origin: Point3f, d: Vector3f, record: UInt32) -> Surface:
        """The point where a ray hits a triangle; `origin` as `enter` gives it."""
        words = load(self.records.words, record)
        corners = triangle_corners(words)
        hit = intersect_triangle(RayPlane(origin, d), *corners)
        # The empty record stands for a miss: any face will do, but one that exists.
        face = dr.select(words[12] >= LEAF, words[13], 0)
        surface = self.meshes.surface(face, corners, hit.b1, hit.b2)
        surface.p = surface.p + self.records.center
        return surface
