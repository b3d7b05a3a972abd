"""Silhouettes of meshes: edges between a triangle that is seen from the front and one from the back, and borders.

Vertices at the same place count as one: meshes of files have several where normals or texture coordinates jump. At such
edges, and at all of a mesh without interpolated normals, shading jumps even where both triangles are seen: with the
flag `DiscontinuityFlags.Creases` they count, too. So do edges at which a texture jumps, flat ones included.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.frame import coordinate_system
from djpt.core.records import RAY_EPSILON, BSDFFlags, DiscontinuityFlags, SurfaceInteraction3f, has_flag
from djpt.core.warp import (
    square_to_uniform_sphere,
    square_to_uniform_spherical_lune,
    square_to_uniform_spherical_lune_pdf,
    uniform_sphere_to_square,
    uniform_spherical_lune_to_square,
)
from djpt.distributions.discrete import Weights
from djpt.jit.types import Array3f64, Bool, Float, Float64, Normal3f, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.silhouettes.base import (
    IN_FRONT,
    INSET,
    PERIMETER,
    Placement,
    SilhouetteOfPoints,
    SurfacePoint,
    edge_normal,
    of_three,
)
from djpt.shapes.silhouettes.foreground import clearance
from djpt.shapes.silhouettes.normals import attached_normals
from djpt.shapes.silhouettes.patterns import AT_SEAMS, EVERYWHERE, jumps_of_textures
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["MeshSilhouette"]

NO_EDGE = 0xFFFFFFFF
"""The number of the opposite edge at a border."""

LEAST_ANGLE = math.radians(1)
"""The least weight of an edge in walks, so that each can be crossed."""

EPSILON = 2.0**-24

MOST_INSET = 0.25
"""How far off a narrow hollow a triangle is looked at, at most, as a fraction of the way to its middle."""

FLAT = 1 - 1e-6
"""The cosine between the normals of triangles above which they count as one plane."""


class MeshSilhouette(SilhouetteOfPoints):
    """The edges, chosen by length; `uv` are barycentric weights. Edge k of triangle f is number 3 f + k."""

    shape: Mesh

    # ---- edges and triangles ------------------------------------------------------------

    def corners(self, edge: UInt32, active: Bool | bool = True) -> tuple[Point3f, Point3f, Point3f]:
        """The ends of an edge, and the third corner of its triangle."""
        face = edge // 3
        corner = edge - 3 * face
        start, mesh = 3 * face, self.shape
        second = dr.select(corner == 2, 0, corner + 1)
        third = dr.select(second == 2, 0, second + 1)
        a, b, c = (
            mesh.vertex_position(dr.gather(UInt32, mesh.faces_parameter, start + k, active), active)
            for k in (corner, second, third)
        )
        return a, b, c

    def neighbour(self, edge: UInt32, active: Bool | bool = True) -> tuple[UInt32, Bool]:
        """The opposite edge, and whether there is one."""
        opposite = dr.gather(UInt32, self.shape.joints[0], edge, active)
        return opposite, (opposite != NO_EDGE) & active

    def normals(self, edge: UInt32, active: Bool | bool) -> tuple[UInt32, Bool, Normal3f, Normal3f]:
        """The opposite edge, whether there is one, and the normals of both triangles."""
        opposite, shared = self.neighbour(edge, active)
        own, other = self.shape.face_normal(edge // 3, active), self.shape.face_normal(opposite // 3, shared)
        return opposite, shared, own, other

    def hollow(self, opposite: UInt32, own: Normal3f, active: Bool | bool) -> Bool:
        """Whether the triangle beyond an edge rises above the plane of the other one, whose normal is `own`."""
        _, end, third = self.corners(opposite, active)
        return dr.dot(own, dr.normalize(third - end)) > 0

    def jumps(self, edge: UInt32, active: Bool | bool = True) -> Bool:
        """Whether shading or a pattern may jump at an edge of whose triangles both are seen."""
        return dr.gather(Bool, self.shape.joints[1], edge, active) | self._pattern_jumps(edge, active)

    def creases(self, edge: UInt32, own: Normal3f, other: Normal3f, active: Bool | bool = True) -> Bool:
        """Whether shading or a pattern jumps at an edge of two triangles, whose normals are given."""
        bent = dr.gather(Bool, self.shape.joints[1], edge, active) & (dr.dot(own, other) < FLAT)
        return bent | self._pattern_jumps(edge, active)

    def _pattern_jumps(self, edge: UInt32, active: Bool | bool) -> Bool:
        if self._pattern == EVERYWHERE:
            return self.neighbour(edge, active)[1]
        return dr.gather(Bool, self.shape.joints[2], edge, active) if self._pattern == AT_SEAMS else Bool(False)

    @cached_property
    def _pattern(self) -> str:
        """Where textures jump from triangle to triangle."""
        return jumps_of_textures(self.shape)

    @cached_property
    def edges(self) -> Weights:
        """All edges that may be on a silhouette, by their lengths, each once and where the mesh lies now."""
        return self._known("_silhouette_edges", creases=False)

    @cached_property
    def edges_and_creases(self) -> Weights:
        """All edges that may be on a silhouette, or at which shading jumps, likewise."""
        return self._known("_edges_and_creases", creases=True)

    def _known(self, name: str, creases: bool) -> Weights:
        """What the mesh has been found to have where it lies now."""
        mesh = self.shape
        key = (mesh.positions, mesh.indices, mesh.normals, self._pattern)
        known = mesh.__dict__.get(name)
        if known is not None and all(a is b for a, b in zip(known[0], key, strict=True)):
            found: Weights = known[1]
            return found
        with dr.suspend_grad():
            edges = Weights(self._weights(creases))
        mesh.__dict__[name] = (key, edges)
        return edges

    def _weights(self, creases: bool) -> Float:
        edge = dr.arange(UInt32, 3 * len(self.shape.indices))
        opposite, shared, own, other = self.normals(edge, True)
        first = shared & (opposite > edge)
        a, b, _ = self.corners(edge)
        bends = dr.dot(own, other) < 1
        creased = self.creases(edge, own, other)
        if not has_flag(self.shape.bsdf().flags(), BSDFFlags.BackSide):
            # From the lit side of a closed mesh only one of both bends is seen as an outline.
            hollow = self.hollow(opposite, own, first)
            bends &= (hollow if self.shape.flip_normals else ~hollow) | dr.any(~shared)
        if creases:
            bends |= creased
        return dr.select((first & bends) | ~shared, dr.norm(b - a), 0)

    # ---- the space of segments ------------------------------------------------------------

    def sample(self, sample: Point3f, flags: int, active: Bool | bool) -> SilhouetteSample3f:
        if not flags & PERIMETER:
            return SilhouetteSample3f()
        creases = bool(flags & DiscontinuityFlags.Creases)
        edge, along, chance = (self.edges_and_creases if creases else self.edges).choose(sample.x, active)
        active = (chance > 0) & active
        a, b, c = self.corners(edge, active)
        _, shared, own, other = self.normals(edge, active)
        on_square = Point2f(sample.y, sample.z)
        d = square_to_uniform_sphere(on_square)
        pdf = Float(0.25 / math.pi)
        any_way = self.jumps(edge, active) if creases else Bool(False)
        if flags & DiscontinuityFlags.DirectionLune:
            in_lune = shared & ~any_way
            d = dr.select(in_lune, square_to_uniform_spherical_lune(on_square, own, other), d)
            pdf = dr.select(in_lune, square_to_uniform_spherical_lune_pdf(d, own, other), pdf)
        parted = dr.dot(d, own) * dr.dot(d, other) < 0
        valid = active & (~shared | parted | any_way) & (pdf != 0)
        ss = self._on_edge(edge, along, a, b, c, d)
        if creases:
            ss.offset = dr.select(shared & ~parted, IN_FRONT, ss.offset)
        ss.pdf = pdf * chance / dr.norm(b - a)
        ss.flags = UInt32(int(flags))
        ss.foreshortening = dr.norm(dr.cross(ss.silhouette_d, d))
        return dr.select(valid, ss, SilhouetteSample3f())

    def _on_edge(
        self, edge: UInt32, along: Float, a: Point3f, b: Point3f, c: Point3f, d: Vector3f
    ) -> SilhouetteSample3f:
        """The point at the fraction `along` of the edge from `a` to `b`; `c` is the third corner."""
        face = edge // 3
        corner = edge - 3 * face
        p = dr.lerp(a, b, along)
        tangent = dr.normalize(b - a)
        uv = dr.select(
            corner == 0,
            Point2f(along, 0),
            dr.select(corner == 1, Point2f(1 - along, along), Point2f(0, 1 - along)),
        )
        return self.sample_of(
            p=p,
            n=edge_normal(d, tangent, c - p),
            uv=uv,
            discontinuity_type=UInt32(PERIMETER),
            d=d,
            silhouette_d=tangent,
            prim_index=face,
            projection_index=corner,
        )

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool) -> Point3f:
        active = (ss.discontinuity_type == PERIMETER) & active
        edge = 3 * ss.prim_index + ss.projection_index
        # Of the two numbers of an edge the smaller one is sampled.
        edge = dr.minimum(edge, self.neighbour(edge, active)[0])
        _, shared, own, other = self.normals(edge, active)
        a, b, _ = self.corners(edge, active)
        along = dr.clip(dr.norm(ss.p - a) / dr.norm(b - a), EPSILON, 1 - EPSILON)
        creases = has_flag(ss.flags, DiscontinuityFlags.Creases)
        begin, chance = (
            dr.select(creases, a, b)
            for a, b in zip(*(place_of(edge, w, active) for w in (self.edges_and_creases, self.edges)), strict=True)
        )
        x = dr.fma(along, chance, begin)
        lune = shared & has_flag(ss.flags, DiscontinuityFlags.DirectionLune) & ~(creases & self.jumps(edge, active))
        square = dr.select(lune, uniform_spherical_lune_to_square(ss.d, own, other), uniform_sphere_to_square(ss.d))
        known = lune | ~shared | has_flag(ss.flags, DiscontinuityFlags.DirectionSphere)
        square = dr.select(known, square, 0)
        return Point3f(dr.select(active, x, 0), square.x, square.y)

    # ---- projections ------------------------------------------------------------------------

    def project(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        """A point of one of the triangle's edges that is on the silhouette; none if no edge is.

        With `HeuristicWalk` any edge may be chosen, by the angle in which it is seen, and `prim_index` is the triangle
        beyond it.
        """
        if not flags & PERIMETER:
            return SilhouetteSample3f()
        mesh = self.shape
        prim = si.prim_index
        vertices = [mesh.vertex_position(i, active) for i in mesh.face_indices(prim, active)]
        own = dr.normalize(dr.cross(vertices[1] - vertices[0], vertices[2] - vertices[0]))
        cosines, beyond, counts = [], [], []
        for k in range(3):
            opposite, shared = self.neighbour(3 * prim + k, active)
            d = dr.normalize(vertices[(k + 1) % 3] - viewpoint)
            other = mesh.face_normal(opposite // 3, shared)
            facing = dr.dot(d, other) * dr.sign(dr.dot(d, own))
            cosines.append(dr.select(shared, facing, -1))
            beyond.append(dr.select(shared, opposite // 3, prim))
            jumps = Bool(False)
            if flags & DiscontinuityFlags.Creases:
                jumps = shared & self.creases(3 * prim + k, own, other, active)
            counts.append((cosines[k] < 0) | jumps)
        if flags & DiscontinuityFlags.HeuristicWalk:
            weights = [dr.select(c <= 0, 0.5 * math.pi, dr.safe_acos(c)) for c in cosines]
            weights = [dr.maximum(w, LEAST_ANGLE) for w in weights]
        else:
            weights = [dr.select(c, Float(1), 0) for c in counts]
        total = weights[0] + weights[1] + weights[2]
        none = total == 0
        weights = [dr.select(none, 1 / 3, w / total) for w in weights]

        second, third = sample >= weights[0], sample >= weights[0] + weights[1]
        edge = dr.select(third, UInt32(2), dr.select(second, UInt32(1), 0))
        before = dr.select(third, weights[0] + weights[1], dr.select(second, weights[0], 0))
        along = (sample - before) / of_three(edge, weights)
        p = of_three(edge, [dr.lerp(vertices[k], vertices[(k + 1) % 3], along) for k in range(3)])
        if flags & DiscontinuityFlags.HeuristicWalk:
            failed = (of_three(edge, cosines) > 0) & ~of_three(edge, counts)
            target = of_three(edge, beyond)
        else:
            failed, target = none, UInt32(prim)
        return self.sample_of(
            p=p,
            d=dr.normalize(p - viewpoint),
            prim_index=target,
            projection_index=edge,
            discontinuity_type=dr.select(~failed & active, UInt32(PERIMETER), 0),
        )

    def precompute(self, viewpoint: Point3f, creases: bool = False, within: float = 0.0) -> tuple[UInt32, Float]:
        edge = dr.arange(UInt32, 3 * len(self.shape.indices))
        a, b, _ = self.corners(edge)
        opposite, shared = self.neighbour(edge)
        part: Any = dr.compress(~shared | ((opposite > edge) & self._counts(edge, a - viewpoint, creases, within)))
        to_a, to_b = dr.normalize(a - viewpoint), dr.normalize(b - viewpoint)
        # The angle in which an edge is seen: a chord of the unit sphere is twice the sine of half of its angle.
        angle = 2 * dr.safe_asin(0.5 * dr.norm(to_b - to_a))
        if creases:
            # Of smooth meshes light jumps at edges inside the outline, where it arrives between the triangles' planes:
            # the root mean square of jumps grows like the root of the angle.
            _, _, own, other = self.normals(edge, True)
            smooth = shared & ~self.creases(edge, own, other) & ~self._counts(edge, a - viewpoint, False, within)
            sine = dr.safe_sqrt(1 - dr.square(dr.dot(own, other)))
            angle *= dr.select(smooth, dr.sqrt(sine), 1)
        return part, dr.gather(Float, angle, part)

    def seen(self, viewpoint: Point3f, part: UInt32, creases: bool) -> Bool:
        _, shared = self.neighbour(part)
        a, _, _ = self.corners(part)
        return ~shared | self._counts(part, a - viewpoint, creases)

    def _counts(self, edge: UInt32, to_edge: Vector3f, creases: bool, within: float = 0.0) -> Bool:
        """Whether shared edges count for a viewer, or for one `within` a distance of it."""
        _, _, own, other = self.normals(edge, True)
        d = dr.normalize(to_edge)
        cos, other_cos, least = dr.dot(d, own), dr.dot(d, other), within * dr.rcp(dr.norm(to_edge))
        parted = cos * other_cos <= 0
        if within:
            parted = (dr.minimum(cos, other_cos) <= least) & (dr.maximum(cos, other_cos) >= -least)
        counts = parted & (dr.abs(dr.dot(own, other)) < 1)
        if creases:
            # At any bend: of smooth meshes, too, which cut off their own light where a triangle turns away from it.
            lit = (dr.dot(own, other) < FLAT) | self._pattern_jumps(edge, True)
            if not has_flag(self.shape.bsdf().flags(), BSDFFlags.BackSide):
                lit &= (cos > -least) if self.shape.flip_normals else (cos < least)
            counts |= lit
        return counts

    def sample_precomputed(
        self, viewpoint: Point3f, part: UInt32, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        a, b, c = self.corners(part, active)
        ss = self._on_edge(part, sample, a, b, c, dr.normalize(dr.lerp(a, b, sample) - viewpoint))
        ss.pdf = dr.rsqrt(dr.squared_norm(b - a))
        _, shared, own, other = self.normals(part, active)
        ss.offset = dr.select(shared & (dr.dot(ss.d, own) * dr.dot(ss.d, other) > 0), IN_FRONT, ss.offset)
        return ss

    def foreground(self, ss: SilhouetteSample3f, active: Bool | bool) -> tuple[Point3f, Normal3f]:
        """Of the two triangles at a silhouette that which is nearer to the viewer; else that of the edge.

        Of a ridge it is the one that is seen from the front, of a hollow the other one.
        """
        edge = 3 * ss.prim_index + ss.projection_index
        opposite, shared, own, other = self.normals(edge, active)
        facing, other_facing = dr.dot(own, ss.d) < 0, dr.dot(other, ss.d) < 0
        ahead = self.hollow(opposite, own, shared)
        beyond = shared & (facing == ahead) & (other_facing != ahead)
        face, n = dr.select(beyond, opposite // 3, ss.prim_index), dr.select(beyond, other, own)
        a, b, c = self.at_corners(self.place(), face, active)
        middle = (a + b + c) / 3 - ss.p
        # In a narrow hollow, the point above must not be beyond the other triangle.
        narrow = ahead & (facing == other_facing) & (dr.dot(own, other) < 0)
        sine = dr.norm(dr.cross(own, other)) * dr.norm(dr.cross(ss.silhouette_d, middle))
        inset = dr.clip(clearance(RAY_EPSILON * (1 + dr.max(dr.abs(ss.p))), sine), INSET, MOST_INSET)
        point = dr.fma(dr.select(narrow, inset, INSET), middle, ss.p)
        return point, -n if self.shape.flip_normals else n

    # ---- motion -------------------------------------------------------------------------------

    def texture_place(self, uv: Point2f, prim_uv: Point2f) -> Point2f:
        return prim_uv

    def follow(self, prim_index: UInt32, uv: Point2f, active: Bool | bool) -> Point3f | None:
        positions = self.attached()
        if positions is None:
            return None
        a, b, c = self.at_corners(positions, prim_index, active)
        u, v = dr.detach(uv.x), dr.detach(uv.y)
        return dr.fma(a, 1 - u - v, dr.fma(b, u, c * v))

    def at_corners(self, values: Float | Float64, prim_index: UInt32, active: Bool | bool) -> list[Point3f]:
        """The positions or the normals, three numbers for each vertex, at the corners of triangles."""
        corners = self.shape.face_indices(prim_index, active)
        return [Point3f(vertex(values, corner, active)) for corner in corners]

    def surface(self, place: Any, p: Point3f, prim_index: UInt32, active: Bool | bool) -> SurfacePoint:
        mesh = self.shape
        a, b, c = self.at_corners(place, prim_index, active)
        plane = Placement(b - a, c - a, Vector3f(0), a)
        n, weights = plane.up(), plane.local(p)
        n = -n if mesh.flip_normals else n
        shares = (1 - weights[0] - weights[1], *weights)
        shading, uv, dp_du = n, Point2f(*weights), b - a
        corners = mesh.face_indices(prim_index, active)
        if mesh.has_vertex_normals():
            normals = attached_normals(mesh) if dr.grad_enabled(place) else mesh.vertex_normals
            at_corners = self.at_corners(normals, prim_index, active)
            shading = dr.normalize(sum((w * Normal3f(m) for w, m in zip(shares, at_corners, strict=True)), Normal3f(0)))
            shading = -shading if mesh.flip_normals else shading
        if mesh.has_vertex_texcoords():
            texcoords = [dr.gather(Point2f, mesh.vertex_texcoords, corner, active) for corner in corners]
            uv = sum((w * t for w, t in zip(shares, texcoords, strict=True)), Point2f(0))
            d1, d2 = texcoords[1] - texcoords[0], texcoords[2] - texcoords[0]
            area = dr.fma(d1.x, d2.y, -d1.y * d2.x)
            mapped = (d2.y * plane.x - d1.y * plane.y) * dr.rcp(dr.select(area != 0, area, 1))
            dp_du = dr.select(area != 0, mapped, coordinate_system(plane.up())[0])
        return SurfacePoint(n, shading, uv, dp_du)


def place_of(edge: UInt32, edges: Weights, active: Bool | bool) -> tuple[Float, Float]:
    """Where the probability of an edge begins, and how large it is."""
    return edges.probability_below(edge, active), edges.probability(edge, active)


def vertex(values: Float | Float64, index: UInt32, active: Bool | bool) -> Any:
    """The three numbers of a vertex."""
    kind = Point3f if isinstance(values, Float) else Array3f64
    return dr.gather(kind, values, index, active, mode=dr.ReduceMode.Local)
