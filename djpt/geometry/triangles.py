"""All triangles of a scene in one BVH, and what their records say about a hit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr

from djpt.geometry.bvh.build import build
from djpt.geometry.bvh.records import LEAF, MESH, WORDS, Records, TriangleData, pack
from djpt.geometry.bvh.search import search
from djpt.geometry.bvh.traversal import NONE, as_float, enter, load, load_second, triangle_corners
from djpt.geometry.bvh.wide import collapse
from djpt.frame import Frame3f, coordinate_system
from djpt.geometry.face_frames import face_frames
from djpt.geometry.mesh_set import MeshSet
from djpt.geometry.surface import Surface
from djpt.geometry.triangle import RayPlane, intersect_triangle
from djpt.lookup import Numbers
from djpt.records import Ray3f
from djpt.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["Triangles"]

FAR = 8
"""In units of the triangles' extent; there rounding is at most 2^-21 of that."""


class Triangles:
    """Ray queries against the meshes of a scene. Faces are named by their record in the BVH."""

    def __init__(self, meshes: MeshSet, shapes: Sequence[int]) -> None:
        """`shapes[i]` is the index in the scene of the i-th mesh."""
        self.meshes = meshes
        self._shapes = list(shapes)
        self._shape_of_mesh = Numbers(self._shapes)
        self._first_face = Numbers(meshes.first_face)
        self.records = self._build()
        self._far = False

    def _build(self) -> Records:
        corners = self.meshes.corners()
        tree = collapse(build(corners.min(axis=1), corners.max(axis=1)))
        normals, directions = face_frames(self.meshes, corners)
        return pack(tree, TriangleData(corners, self.meshes.mesh_of_face(), normals, directions))

    def move(self, mesh: Mesh) -> None:
        """A mesh has new vertices or faces."""
        self.meshes.refresh(mesh)
        self.records = self._build()

    def seen_from(self, distance: float) -> None:
        """Rays may start as far as that from the centre: from far away they are moved near, see `enter`.

        Whether they are is structure, since it costs a few per cent; once far, always far.
        """
        self._far |= distance > FAR * self.records.extent

    # ---- ray queries -----------------------------------------------------------------

    def enter(self, ray: Ray3f) -> tuple[Point3f, Float | None]:
        """The origin as seen from the centre, moved near the triangles if rays start far away; and how far."""
        return enter(self.records, ray) if self._far else (ray.o - self.records.center, None)

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

    def surface(self, origin: Point3f, d: Vector3f, t: Float, record: UInt32, b: Point2f | None, full: bool) -> Surface:
        """The point where a ray hits a triangle, `t` beyond `origin`, which is what `enter` gave.

        `b` are the barycentric weights, if they are known. Unless `full`, uv and the lengths of dp/du
        and dp/dv aren't needed: that takes half a record, and no corners.
        """
        if full or (self.meshes.smooth and b is None):
            words = load(self.records.words, record)
            corners = triangle_corners(words)
            hit = intersect_triangle(RayPlane(origin, d), *corners)
            # The empty record stands for a miss: any face will do, but one that exists.
            face = dr.select(words[12] >= LEAF, words[13], 0)
            surface = self.meshes.surface(face, corners, hit.b1, hit.b2)
            surface.p = surface.p + self.records.center
            return surface
        half = load_second(self.records.words, record)
        n = Vector3f(*(as_float(word) for word in half[1:4]))
        s, t_ = coordinate_system(n)
        dp_du = dr.fma(s, as_float(half[6]), t_ * as_float(half[7]))
        p = dr.fma(d, t, origin) + self.records.center
        frame, weights = Frame3f(dp_du, dr.cross(n, dp_du), n), Point2f(0)
        if b is not None:
            weights = b
            frame = self.meshes.smooth_frame(dr.select(half[4] >= LEAF, half[5], 0), b, n, dp_du)
        return Surface(p, n, frame, weights, dp_du, frame.t, weights)
