"""Silhouettes of cubes: edges between a face that is seen from the front and one from the back."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from djpt.core.lookup import choose
from djpt.core.records import DiscontinuityFlags, SurfaceInteraction3f, has_flag
from djpt.core.warp import (
    square_to_uniform_sphere,
    square_to_uniform_spherical_lune,
    square_to_uniform_spherical_lune_pdf,
    uniform_sphere_to_square,
    uniform_spherical_lune_to_square,
)
from djpt.jit.types import Bool, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.cube import FACES
from djpt.shapes.silhouettes.base import (
    IN_FRONT,
    INSET,
    PERIMETER,
    Placement,
    Silhouette,
    SurfacePoint,
    edge_normal,
)
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["CubeSilhouette"]

EDGES = 12
FACE_OF = {(axis, sign): number for number, ((axis, sign), _, _) in enumerate(FACES)}


class Edge:
    """Edges by number: that number 4 a + 2 i + j runs along the axis a, on the faces of the two next axes.

    Of these faces, i and j say whether they are those at -1 or at 1.
    """

    def __init__(self, cube: CubeSilhouette, number: UInt32) -> None:
        self.number, self.axis = number, number // 4
        shape = cube.shape
        spans, duals = (shape.edge_x, shape.edge_y, shape.edge_z), (shape.dual_x, shape.dual_y, shape.dual_z)
        sides = (has_flag(number, 2), has_flag(number, 1))
        signs = [dr.select(side, Float(1), -1) for side in sides]
        self.along = choose(self.axis, spans)
        """Half of the edge."""
        self.sides = [choose(self.axis, [spans[(a + k) % 3] for a in range(3)]) * signs[k - 1] for k in (1, 2)]
        """From the centre of the cube to those of its two faces."""
        self.normals = [
            dr.normalize(choose(self.axis, [duals[(a + k) % 3] for a in range(3)])) * signs[k - 1] for k in (1, 2)
        ]
        """The outer normals of the faces."""
        self.faces = [
            choose(
                2 * self.axis + dr.select(sides[k - 1], UInt32(1), 0),
                [UInt32(FACE_OF[(a + k) % 3, sign]) for a in range(3) for sign in (-1, 1)],
            )
            for k in (1, 2)
        ]

    def parted(self, d: Vector3f) -> Bool:
        """Whether one face is seen from the front and the other from the back, along `d`."""
        return dr.dot(d, self.normals[0]) * dr.dot(d, self.normals[1]) < 0


class CubeSilhouette(Silhouette):
    """The edges, chosen by length. `prim_index` is a triangle of one of the two faces, and `uv` are that face's.

    Where both faces are seen shading jumps, and with `DiscontinuityFlags.Creases` edges count there, too.
    """

    def sample(self, sample: Point3f, flags: int, active: Bool | bool) -> SilhouetteSample3f:
        if not flags & PERIMETER:
            return SilhouetteSample3f()
        lengths = self._lengths()
        x = sample.x * (lengths[0] + lengths[1] + lengths[2])
        second, third = x >= lengths[0], x >= lengths[0] + lengths[1]
        axis = dr.select(third, UInt32(2), dr.select(second, UInt32(1), 0))
        before = dr.select(third, lengths[0] + lengths[1], dr.select(second, lengths[0], 0))
        place = dr.clip(4 * (x - before) / choose(axis, lengths), 0, 4 * (1 - 2**-23))
        which = UInt32(place)
        edge = Edge(self, 4 * axis + which)
        square = Point2f(sample.y, sample.z)
        d, pdf = square_to_uniform_sphere(square), Float(0.25 / math.pi)
        if flags & DiscontinuityFlags.DirectionLune and not flags & DiscontinuityFlags.Creases:
            d = square_to_uniform_spherical_lune(square, *edge.normals)
            pdf = square_to_uniform_spherical_lune_pdf(d, *edge.normals)
        ss = self._on_edge(edge, place - Float(which), d)
        ss.pdf = pdf * dr.rcp(8 * (lengths[0] + lengths[1] + lengths[2]))
        ss.flags = UInt32(int(flags))
        ss.foreshortening = dr.norm(dr.cross(ss.silhouette_d, d))
        valid = (pdf != 0) & (Bool(bool(flags & DiscontinuityFlags.Creases)) | edge.parted(d))
        return dr.select(valid, ss, SilhouetteSample3f())

    def _lengths(self) -> list[Float]:
        """Half of the lengths of edges along the three axes."""
        shape = self.shape
        return [dr.norm(v) for v in (shape.edge_x, shape.edge_y, shape.edge_z)]

    def _on_edge(self, edge: Edge, along: Float, d: Vector3f) -> SilhouetteSample3f:
        """The point at the fraction `along` of an edge; it looks at the first of the two faces."""
        shape = self.shape
        p = dr.fma(edge.along, 2 * along - 1, shape.center + edge.sides[0] + edge.sides[1])
        uv = shape.uv_and_partials(p, edge.faces[0])[0]
        tangent = dr.normalize(edge.along)
        return self.sample_of(
            p=p,
            n=edge_normal(d, tangent, -edge.sides[1]),
            uv=uv,
            discontinuity_type=UInt32(PERIMETER),
            d=d,
            silhouette_d=tangent,
            prim_index=2 * edge.faces[0],
            projection_index=edge.number,
        ).replaced(offset=dr.select(edge.parted(d), Float(0), IN_FRONT))

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool) -> Point3f:
        edge, lengths = Edge(self, ss.projection_index), self._lengths()
        total = lengths[0] + lengths[1] + lengths[2]
        start = self.shape.center + edge.sides[0] + edge.sides[1]
        along = dr.fma(0.5, dr.dot(ss.p - start, edge.along) / dr.squared_norm(edge.along), 0.5)
        before = choose(edge.axis, [Float(0), lengths[0], lengths[0] + lengths[1]])
        share = 0.25 * choose(edge.axis, lengths)
        x = dr.fma(share, dr.clip(along, 1e-6, 1 - 1e-6) + Float(edge.number & 3), before) / total
        lune = has_flag(ss.flags, DiscontinuityFlags.DirectionLune) & ~has_flag(ss.flags, DiscontinuityFlags.Creases)
        square = dr.select(lune, uniform_spherical_lune_to_square(ss.d, *edge.normals), uniform_sphere_to_square(ss.d))
        return dr.select(ss.is_valid() & active, Point3f(x, square.x, square.y), 0)

    def project(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        """A uniform point of an edge that is on the silhouette, or with `Creases` of any that may be seen."""
        if not flags & PERIMETER:
            return SilhouetteSample3f()
        counts = [self._counts(Edge(self, UInt32(k)), viewpoint, flags) for k in range(EDGES)]
        total = sum((dr.select(c, UInt32(1), 0) for c in counts), UInt32(0))
        place = sample * Float(total)
        chosen, seen = UInt32(0), UInt32(0)
        for k, c in enumerate(counts):
            chosen = dr.select(c & (seen == UInt32(place)), UInt32(k), chosen)
            seen = seen + dr.select(c, UInt32(1), 0)
        ss = self._seen_edge(viewpoint, chosen, place - Float(UInt32(place)))
        ss.discontinuity_type = dr.select((total > 0) & active, UInt32(PERIMETER), 0)
        ss.flags = UInt32(int(flags))
        return ss

    def _counts(self, edge: Edge, viewpoint: Point3f, flags: int) -> Bool:
        """Whether edges are on the silhouette seen from a point, or may be seen as creases."""
        d = self.shape.center + edge.sides[0] + edge.sides[1] - viewpoint
        parted = edge.parted(d)
        if not flags & DiscontinuityFlags.Creases:
            return parted
        return parted | (dr.dot(d, edge.normals[0]) < 0) | self._contains(viewpoint)

    def _contains(self, p: Point3f) -> Bool:
        """Whether a point lies inside."""
        local = p - self.shape.center
        inside = Bool(True)
        for dual in (self.shape.dual_x, self.shape.dual_y, self.shape.dual_z):
            inside = inside & (dr.abs(dr.dot(dual, local)) < 1)
        return inside

    def _seen_edge(self, viewpoint: Point3f, number: UInt32, along: Float) -> SilhouetteSample3f:
        """The point at the fraction `along` of an edge, seen from `viewpoint`."""
        edge = Edge(self, number)
        p = dr.fma(edge.along, 2 * along - 1, self.shape.center + edge.sides[0] + edge.sides[1])
        return self._on_edge(edge, along, dr.normalize(p - viewpoint))

    def precompute(self, viewpoint: Point3f, creases: bool = False, within: float = 0.0) -> tuple[UInt32, Float]:
        number = dr.arange(UInt32, EDGES)
        edge = Edge(self, number)
        # Those few that are seen from elsewhere are all taken.
        part: Any = number if within else dr.compress(self.seen(viewpoint, number, creases))
        middle = self.shape.center + edge.sides[0] + edge.sides[1]
        to_a, to_b = (dr.normalize(middle + sign * edge.along - viewpoint) for sign in (-1, 1))
        # The angle in which an edge is seen: a chord of the unit sphere is twice the sine of half of its angle.
        angle = 2 * dr.safe_asin(0.5 * dr.norm(to_b - to_a))
        return part, dr.gather(Float, angle, part)

    def seen(self, viewpoint: Point3f, part: UInt32, creases: bool) -> Bool:
        return self._counts(Edge(self, part), viewpoint, int(DiscontinuityFlags.Creases) if creases else 0)

    def sample_precomputed(
        self, viewpoint: Point3f, part: UInt32, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        ss = self._seen_edge(viewpoint, part, sample)
        ss.pdf = dr.rcp(2 * dr.norm(Edge(self, part).along))
        return ss

    def foreground(self, ss: SilhouetteSample3f, active: Bool | bool) -> tuple[Point3f, Normal3f]:
        """Of the two faces at a silhouette that which is seen from the front; else the first."""
        edge = Edge(self, ss.projection_index)
        second = edge.parted(ss.d) & (dr.dot(ss.d, edge.normals[0]) > 0)
        middle = self.shape.center + dr.select(second, edge.sides[1], edge.sides[0])
        n = dr.select(second, edge.normals[1], edge.normals[0])
        return dr.fma(INSET, middle - ss.p, ss.p), -n if self.shape.flip_normals else n

    # ---- motion ------------------------------------------------------------------------------

    def place(self) -> Placement:
        shape = self.shape
        return Placement(shape.edge_x, shape.edge_y, shape.edge_z, Point3f(shape.center))

    def follow(self, prim_index: UInt32, uv: Point2f, active: Bool | bool) -> Point3f | None:
        place = self.attached(dr.width(uv))
        if place is None:
            return None
        face, u, v = prim_index // 2, dr.fma(2, dr.detach(uv.x), -1), dr.fma(2, dr.detach(uv.y), -1)
        rows = []
        for axes in FACES:
            local = [Float(0)] * 3
            for (axis, sign), value in zip(axes, (Float(1), u, v), strict=True):
                local[axis] = sign * value
            rows.append(Point3f(*local))
        return place.point(choose(face, rows))

    def surface(self, place: Any, p: Point3f, prim_index: UInt32, active: Bool | bool) -> SurfacePoint:
        columns = (place.x, place.y, place.z)
        duals = [dr.cross(columns[(k + 1) % 3], columns[(k + 2) % 3]) for k in range(3)]
        volume = dr.dot(columns[0], duals[0])
        face = prim_index // 2
        n = choose(face, [dr.normalize(duals[a] / volume) * sign for (a, sign), _, _ in FACES])
        n = -n if self.shape.flip_normals else n
        local = [dr.dot(p - place.origin, dual) / volume for dual in duals]
        u, v = (choose(face, [dr.fma(0.5 * axes[k][1], local[axes[k][0]], 0.5) for axes in FACES]) for k in (1, 2))
        return SurfacePoint(n, n, Point2f(u, v), choose(face, [columns[a] * (2 * sign) for _, (a, sign), _ in FACES]))
