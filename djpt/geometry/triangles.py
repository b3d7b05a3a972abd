"""All triangles of a scene in one BVH: ray queries, and the surface points of hits."""

from __future__ import annotations

import copy
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f, coordinate_system
from djpt.core.lookup import Numbers
from djpt.core.records import Ray3f
from djpt.core.records.flags import SurfaceDetail
from djpt.geometry.bvh.calls.trees import CompiledTree
from djpt.geometry.bvh.steps.records import LEAF, NUMBER, PORTAL, SOLID
from djpt.geometry.bvh.steps.traversal import into_group
from djpt.geometry.canonical import FLAT_KINDS, PIECE
from djpt.geometry.canonical import surface as canonical_surface
from djpt.geometry.curve_segments import CurveSegmentSet
from djpt.geometry.null_meshes import NullMeshes
from djpt.geometry.query import DETAIL, LABEL, NONE, Found, Near, RayTree, enter
from djpt.geometry.triangle import RayPlane, intersect_triangle
from djpt.geometry.two_level_bvh import TwoLevelBVH
from djpt.jit.kernels import float_in
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.base import Surface
from djpt.shapes.meshes.mesh_set import MeshSet

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["Triangles"]

FAR = 8
"""Origins further away, in units of the triangles' extent, are moved near; at FAR, rounding is 2^-21 of the extent."""


class Triangles:
    """Ray queries against the meshes of a scene. A face is identified by its record in the BVH."""

    def __init__(self, meshes: MeshSet, shapes: Sequence[int], two_level_bvh: TwoLevelBVH) -> None:
        """`shapes` are the scene's indices of the meshes, then of the analytic shapes that `two_level_bvh` holds."""
        self.meshes, self.two_level_bvh = meshes, two_level_bvh
        self._shapes = list(shapes)
        self._shape_of_mesh = Numbers(self._shapes)
        self._first_face = Numbers(meshes.first_face)
        self._mesh_count = len(meshes.meshes)
        start = time.perf_counter()
        self._use(two_level_bvh.tree())
        self.build_seconds = time.perf_counter() - start
        self._far = False

    def move(self, meshes: Sequence[Mesh]) -> None:
        """Follow an edit: `meshes` have new vertices or faces, or instances have moved."""
        if meshes:
            self.meshes.refresh()
        self._first_face = Numbers(self.meshes.first_face)
        self._use(self.two_level_bvh.tree())

    def _use(self, tree: RayTree) -> None:
        self.tree = tree
        self._center = np.array(tree.center).ravel()

    def seen_from(self, points: Sequence[NDArray[np.float64]]) -> Triangles:
        """A view of these triangles for rays that start near the `points` (3,).

        From far away rays are moved near, see `enter`. Whether they are is structure, since it costs a few per cent.
        """
        distance = max(float(np.linalg.norm(p - self._center)) for p in points)
        if self._far or not distance > FAR * self.tree.extent:
            return self
        view = copy.copy(self)
        view._far = True
        return view

    # ---- ray queries -----------------------------------------------------------------

    def enter(self, ray: Ray3f) -> tuple[Point3f, Float | None]:
        """The origin as seen from the centre, moved near if rays start far away; and the distance moved, or None."""
        return enter(self.tree, ray) if self._far else (ray.o - self.tree.center, None)

    @property
    def emit(self) -> bool:
        """Whether any of these shapes is a light."""
        return self.two_level_bvh.emits

    def search(self, ray: Ray3f, through_lights: Bool | None) -> Found:
        """The first hit with 0 < t < maxt. Where `through_lights`, shapes that emit are ignored."""
        return self.tree.search(ray, False, through_lights=through_lights if self.emit else None)

    def occluded(self, ray: Ray3f, active: Bool | bool) -> Bool:
        """Whether there is a hit with 0 < t < maxt."""
        return self.tree.search(ray, True, active).record != NONE

    @property
    def searches_pairs(self) -> bool:
        """Whether there is `search_pairs`."""
        return isinstance(self.tree, CompiledTree) and self.tree.functions.pairs is not None

    def search_pairs(
        self, ray: Ray3f, to_light: Ray3f, followed: Bool, through_lights: Bool | None
    ) -> tuple[Found, Bool]:
        """`search` for `ray`, and where `followed` whether the ray `to_light` is `occluded`, at once."""
        assert isinstance(self.tree, CompiledTree)
        return self.tree.search_pairs(ray, to_light, followed, through_lights if self.emit else None)

    @property
    def can_measure(self) -> bool:
        """Whether `lengths` can tell how far rays run through media."""
        return isinstance(self.tree, CompiledTree) and self.tree.functions.lengths is not None

    def lengths(self, ray: Ray3f, active: Bool, medium: UInt32) -> tuple[Bool, list[Float]]:
        """Whether something opaque is hit with 0 < t < maxt, and if not, the lengths of a ray through media.

        These are the media of `null_meshes`, and others that no invisible mesh has on its sides.

        Args:
            ray: The ray, with a unit direction.
            active: Lanes that have a ray.
            medium: The number of the medium in which it begins, as in `djpt.geometry.null_meshes`.
        """
        assert isinstance(self.tree, CompiledTree)
        origin, entry = self.enter(ray)
        if entry is None:
            return self.tree.lengths(origin, ray.d, ray.maxt, active, medium)
        blocked, lengths = self.tree.lengths(origin, ray.d, ray.maxt - entry, active, medium)
        return blocked, [dr.select(medium == k, length + entry, length) for k, length in enumerate(lengths, 1)]

    @property
    def null_meshes(self) -> NullMeshes:
        """The invisible meshes."""
        return self.two_level_bvh.null_meshes

    def follow_bsdfs(self) -> None:
        """Follow an edit of the meshes' BSDFs and media."""
        if not self.two_level_bvh.is_current:
            self._use(self.two_level_bvh.tree())

    # ---- what a record says --------------------------------------------------------------

    def owner_of(self, record: UInt32) -> UInt32:
        """The number of the mesh or analytic shape of a record, or the number of the instance; of NONE any number."""
        return self.tree.word(record, LABEL, record != NONE) & NUMBER

    def shape_of(self, record: UInt32) -> UInt32:
        """The index in the scene of the shape that a record belongs to."""
        return self._shape_of_mesh.at(self.owner_of(record))

    def per_mesh(self, of_shape: Sequence[int]) -> Numbers:
        """Turn a table of numbers by shape into one by mesh."""
        return Numbers([of_shape[shape] for shape in self._shapes])

    def primitive_index(self, record: UInt32, p: Point3f) -> UInt32:
        """The number of a triangle in its mesh; on analytic shapes Mitsuba's number of the primitive at `p`."""
        face = self.tree.word(record, DETAIL, record != NONE)
        mesh = self.owner_of(record)
        index: UInt32 = face - self._first_face.at(mesh)
        if any(shape.faces_per_primitive != 1 for shape in self.meshes.meshes):
            parts = [shape.faces_per_primitive for shape in self.meshes.meshes]
            index = index // Numbers([*parts, *([1] * (len(self._shapes) - len(parts)))]).at(mesh)
        if self.tree.kinds:
            words = self.tree.map_rows(record)
            solid = UInt32(0)
            if self._solid_kinds:
                local, _ = into_group(words, p - self.tree.center, Vector3f(0))
                solid = canonical_surface(self._solid_kinds, words[13], local).triangle
            if self.two_level_bvh.pieces is not None:
                is_piece = self._is_piece(words)
                segment = self.two_level_bvh.pieces.segment(words[13] - PIECE, is_piece)
                solid = dr.select(is_piece, segment, solid)
            index = dr.select(mesh < self._mesh_count, index, solid)
        return index

    def attribute(self, name: str, record: UInt32, uv: Point2f, active: Bool | bool) -> Any:
        """An attribute of the meshes at the barycentric coordinates `uv` of triangles; unspecified on other records."""
        active = active & (record != NONE)
        kind, number = (self.tree.word(record, k, active) for k in (LABEL, DETAIL))
        face = dr.select(active & ((kind & PORTAL) == 0), self._face(kind, number), 0)
        return self.meshes.attribute(name, face, uv.x, uv.y)

    def surface(self, near: Near, d: Vector3f, t: Float, record: UInt32, detail: SurfaceDetail) -> Surface:
        """The point where a ray hits a triangle; `t` counts from `near.origin`.

        Only the partials need the corners of triangles; for all else the row of the record is enough, and that of the
        mesh's face.
        """
        if self.tree.kinds:
            solid = self._placed(near, d, t, record)
            if not self.meshes.meshes:
                return solid
            is_solid = self.tree.word(record, LABEL, record != NONE) & SOLID
            return dr.select(is_solid != 0, solid, self._on_triangle(near, d, t, record, detail))
        return self._on_triangle(near, d, t, record, detail)

    def _on_triangle(self, near: Near, d: Vector3f, t: Float, record: UInt32, detail: SurfaceDetail) -> Surface:
        interpolates = self.meshes.smooth or detail is SurfaceDetail.UV
        if detail is SurfaceDetail.PARTIALS or (interpolates and near.b is None):
            if near.inside is not None:
                return self._instanced(near, near.inside, d, t, record)
            return self._by_corners(near, near.origin, d, record)
        words = self.tree.row(record)
        n = Vector3f(*(float_in(word) for word in words[1:4]))
        tangents = coordinate_system(n)
        dp_du = dr.fma(tangents[0], float_in(words[6]), tangents[1] * float_in(words[7]))
        frame, uv, weights = Frame3f(dp_du, dr.cross(n, dp_du), n), Point2f(0), Point2f(0)
        if near.b is not None:
            uv = weights = near.b
        if interpolates:
            corners = self.meshes.corner_row(self._face(words[4], words[5]))
            frame = self.meshes.smooth_frame(corners, weights, n, dp_du)
            uv = self.meshes.uv(corners, weights)
        surface = Surface(dr.fma(d, t, near.origin) + self.tree.center, n, frame, uv, dp_du, frame.t, weights)
        if near.inside is None:
            return surface
        p = surface.p
        surface = dr.select(near.inside != NONE, to_world(self.tree.map_rows(near.inside), surface), surface)
        surface.p = p
        return surface

    def _face(self, label: UInt32, detail: UInt32) -> UInt32:
        """The face of a triangle by the words of its record; of any other record the first face, which exists.

        There the second word is something else, for pieces of curves their number.
        """
        is_face = label >= LEAF
        if self.tree.kinds:
            is_face &= (label & SOLID) == 0
        return dr.select(is_face, detail, 0)

    @property
    def _solid_kinds(self) -> list[int]:
        """The kinds of analytic shapes that are whole, not in pieces."""
        return [kind for kind in self.tree.kinds if kind != PIECE]

    @staticmethod
    def _is_piece(words: list[UInt32]) -> Bool:
        """Whether the record of a placed primitive, by its words, is a piece of a curve."""
        return (words[12] >= LEAF) & ((words[12] & SOLID) != 0) & (words[13] >= PIECE)

    def _placed(self, near: Near, d: Vector3f, t: Float, record: UInt32) -> Surface:
        """The point on an analytic shape or a curve."""
        words = self.tree.map_rows(record)
        if self.two_level_bvh.pieces is None:
            return self._solid(near, d, t, words)
        piece = self._piece(near, d, t, words, self.two_level_bvh.pieces)
        return dr.select(self._is_piece(words), piece, self._solid(near, d, t, words)) if self._solid_kinds else piece

    def _piece(self, near: Near, d: Vector3f, t: Float, words: list[UInt32], pieces: CurveSegmentSet) -> Surface:
        """The point on a curve or an ellipsoid."""
        o, local_d = into_group(words, near.origin, d)
        local, p = dr.fma(local_d, t, o), dr.fma(d, t, near.origin) + self.tree.center
        number, active = words[13] - PIECE, self._is_piece(words)
        curve: Any = None
        if pieces.has_curves:
            radii = dr.abs(float_in(words[14])), float_in(words[15])
            curve = pieces.curve(number, p, d, local.z, radii, active)
        if not pieces.has_ellipsoids:
            return curve
        zero, n = Vector3f(0), Vector3f(local)
        ball = Surface(zero, n, Frame3f(zero, zero, n), Point2f(0), zero, zero, Point2f(0))
        ellipsoid = to_world(words, ball)
        ellipsoid.p = p
        if curve is None:
            return ellipsoid
        return dr.select(pieces.is_ellipsoid(number, active), ellipsoid, curve)

    def _solid(self, near: Near, d: Vector3f, t: Float, words: list[UInt32]) -> Surface:
        """The point on an analytic shape."""
        o, local_d = into_group(words, near.origin, d)
        local = canonical_surface(self._solid_kinds, words[13], dr.fma(local_d, t, o))
        zero = Vector3f(0)
        point = Surface(zero, local.n, Frame3f(zero, zero, local.n), local.uv, local.dp_du, local.dp_dv, Point2f(0))
        placed = to_world(words, point)
        side, mirrored = float_in(words[14]), orientation(words)
        shading = placed.sh_frame.n * side
        placed.sh_frame = Frame3f(placed.sh_frame.s, dr.cross(shading, placed.sh_frame.s), shading)
        # As in Mitsuba, reflections turn the geometric normal of shapes that are flat there, and no other.
        flat = words[13] < FLAT_KINDS
        placed.n = placed.n * dr.select(flat, side * mirrored, side)
        placed.p = dr.fma(d, t, near.origin) + self.tree.center
        return placed

    def _by_corners(self, near: Near, o: Point3f, d: Vector3f, record: UInt32) -> Surface:
        """The full surface point; the ray o, d is in the space of the triangle's tree, relative to its centre."""
        row = self.tree.row(record)
        face, b = self._face(row[LABEL], row[DETAIL]), near.b
        corners, center = self.tree.corners(record), self.tree.center
        if corners is None:
            corners, center = self.meshes.vertices(face), Point3f(0)
        if b is None:
            hit = intersect_triangle(RayPlane(o + (self.tree.center - center), d), *corners)
            b = Point2f(hit.b1, hit.b2)
        surface = self.meshes.surface(face, corners, b.x, b.y)
        surface.p = surface.p + center
        return surface

    def _instanced(self, near: Near, inside: UInt32, d: Vector3f, t: Float, record: UInt32) -> Surface:
        """The point on a triangle that may belong to an instance."""
        within = inside != NONE
        words = self.tree.map_rows(inside)
        o, local_d = into_group(words, near.origin, d)
        surface = self._by_corners(near, dr.select(within, o, near.origin), dr.select(within, local_d, d), record)
        p = dr.select(within, dr.fma(d, t, near.origin) + self.tree.center, surface.p)
        surface = dr.select(within, to_world(words, surface), surface)
        surface.p = p
        return surface


def rows_of(words: list[UInt32]) -> list[Vector3f]:
    """The linear part of the map that a record holds."""
    m = [float_in(word) for word in words[:12]]
    return [Vector3f(m[4 * i], m[4 * i + 1], m[4 * i + 2]) for i in range(3)]


def orientation(words: list[UInt32]) -> Float:
    """-1 where the map of a record is a reflection, else 1."""
    rows = rows_of(words)
    return dr.select(dr.dot(rows[0], dr.cross(rows[1], rows[2])) < 0, Float(-1), 1)


def to_world(words: list[UInt32], surface: Surface) -> Surface:
    """Map a surface point from the space of a group to the world, by the record of an instance; `p` is kept."""
    rows = rows_of(words)
    # The columns of the inverse, which maps back into the world.
    adjugate = [dr.cross(rows[1], rows[2]), dr.cross(rows[2], rows[0]), dr.cross(rows[0], rows[1])]
    inv = dr.rcp(dr.dot(rows[0], adjugate[0]))

    def vector(v: Vector3f) -> Vector3f:
        return (adjugate[0] * v.x + adjugate[1] * v.y + adjugate[2] * v.z) * inv

    def normal(n: Vector3f) -> Vector3f:
        turned = rows[0] * n.x + rows[1] * n.y + rows[2] * n.z
        squared = dr.squared_norm(turned)
        return dr.select(squared > 0, turned * dr.rsqrt(squared), Vector3f(0, 0, 1))

    n, dp_du, shading = normal(surface.n), vector(surface.dp_du), normal(surface.sh_frame.n)
    s = dr.fma(shading, -dr.dot(shading, dp_du), dp_du)
    squared = dr.squared_norm(s)
    s = dr.select(squared > 0, s * dr.rsqrt(squared), coordinate_system(shading)[0])
    frame = Frame3f(s, dr.cross(shading, s), shading)
    return Surface(surface.p, n, frame, surface.uv, dp_du, vector(surface.dp_dv), surface.prim_uv)
