"""Silhouettes of B-spline curves: where the tubes turn away, and the circles at their open ends.

A point of a tube is p = c + r a, with the axis c(v), the radius r(v), and a unit vector a across the axis, at the angle
phi. T is the unit tangent of the axis, b = T x a; primes are derivatives by v. If a follows the axis without turning
about it, a' = -(a . T') T, and

    dp/dphi = r b,    dp/dv = alpha T + beta a,    alpha = |c'| - r (a . T'),    beta = r'.

These are perpendicular to each other; the outward normal is (alpha a - beta T) / |dp/dv|. A viewer at o sees the tube
turn away where

    (w . a + r) alpha = (w . T) beta,    w = c - o.

There the silhouette runs in the direction t that is conjugate to the line of sight d: II(d, t) = 0, with the second
fundamental form II, whose entries by phi and v are, times |dp/dv|,

    -r alpha,    r beta (b . T'),    k alpha^2 + 2 k beta^2 + r beta (a . T'') - beta |c'|' + alpha r'',    k = a . T'.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import SurfaceInteraction3f
from djpt.core.warp import (
    interval_to_tangent_direction,
    square_to_uniform_hemisphere,
    square_to_uniform_hemisphere_pdf,
    tangent_direction_to_interval,
    turns,
    uniform_hemisphere_to_square,
)
from djpt.jit.types import Array4f, Array4f64, Bool, Float, Float64, Normal3f, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.cubic_curve import Place, cubic_place, local_axes, unit, vector
from djpt.shapes.silhouettes.base import INTERIOR, PERIMETER, SilhouetteOfPoints, SurfacePoint, edge_normal
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["BSplineCurveSilhouette"]

GAP = 1 / 64
"""How far rays keep clear of silhouettes, in radii: they meet straight pieces, off the curve by up to half of that."""

INSET = 0.02
"""How far off an end the tube is looked at, in radii."""

STEPS = 6
"""Newton's steps to the angle at which a tube turns away, and to the circle that a point lies on."""


@dataclass
class Ring:
    """The circle of a tube at a place of its axis."""

    place: Place
    tangent: Vector3f
    turn: Vector3f
    """The derivative of the tangent by v."""
    rotation: Vector3f
    origin: Vector3f
    """The axes across, by which angles are counted: they begin at `origin`."""

    @staticmethod
    def of(place: Place) -> Ring:
        """The circle at a place, across the axis."""
        tangent = unit(place.dc)
        rotation, origin, _ = local_axes(tangent, place)
        bend = place.ddc - tangent * dr.dot(tangent, place.ddc)
        return Ring(place, tangent, bend * dr.rsqrt(dr.maximum(dr.squared_norm(place.dc), 1e-30)), rotation, origin)

    @staticmethod
    def at_end(place: Place, next_place: Place) -> Ring:
        """The circle at an end, which rays see across the chord to the end of the straight piece that they meet."""
        chord = next_place.c - place.c
        straight = Place(place.c, chord, Vector3f(0), place.r, next_place.r - place.r, Float(0))
        tangent = unit(chord)
        return Ring(straight, tangent, Vector3f(0), *local_axes(tangent, straight)[:2])

    def out(self, phi: Float) -> Vector3f:
        """The unit vector across at an angle."""
        sin, cos = dr.sincos(phi)
        return self.origin * cos + self.rotation * sin

    def point(self, out: Vector3f) -> Point3f:
        """The point of the circle in a direction across."""
        return Point3f(dr.fma(out, self.place.r, self.place.c))

    def along(self, out: Vector3f) -> tuple[Float, Float]:
        """The derivative of a point by v, along the tangent and across: (alpha, beta)."""
        return dr.fma(-self.place.r, dr.dot(out, self.turn), dr.norm(self.place.dc)), self.place.dr

    def normal(self, out: Vector3f) -> Normal3f:
        """The outward unit normal of the tube in a direction across."""
        alpha, beta = self.along(out)
        return Normal3f(unit(out * alpha - self.tangent * beta))


class End(NamedTuple):
    """The end of a tube."""

    ring: Ring
    inward: Vector3f
    """The direction from there along the tube."""
    gap: Float
    """What rays must keep clear of the circle."""


class BSplineCurveSilhouette(SilhouetteOfPoints):
    """The silhouettes of all curves of a shape. `uv` are texture coordinates, `prim_index` is the segment.

    Samples are chosen as in Mitsuba: curves and segments with equal chances, whatever their lengths.
    """

    types = PERIMETER | INTERIOR
    grazing = 0.02
    """Rays that meet a straight piece, but pass the curve, have a point where they graze it."""

    # ---- places ---------------------------------------------------------------------------

    def ring(
        self, prim_index: UInt32, v: Float, active: Bool | bool, controls: Float | Float64 | None = None
    ) -> tuple[Ring, list[Array4f]]:
        """The circle at the parameter v of a segment, and the segment's control points.

        Args:
            prim_index: the segment.
            v: from 0 to 1.
            active: the lanes that read control points.
            controls: the control points; default: as they are, without gradients.
        """
        points = self.controls(prim_index, active, controls)
        return Ring.of(cubic_place(points, v)), points

    def end(self, prim_index: UInt32, v: Float, active: Bool | bool, controls: Float | Float64 | None = None) -> End:
        """The end of a curve, where v is 0 or 1.

        Where a tube bends within less than its width, its second piece reaches beyond the first one.
        """
        points = self.controls(prim_index, active, controls)
        step = dr.rcp(Float(dr.gather(UInt32, self.shape.piece_counts, prim_index, active)))
        begins = v < 0.5
        first, second = (
            cubic_place(points, dr.select(begins, low, high)) for low, high in ((Float(0), 1 - step), (step, Float(1)))
        )
        ring = Ring.at_end(first, second)
        last = ring.place
        last.c, last.r = dr.select(begins, first.c, second.c), dr.select(begins, first.r, second.r)
        turn = dr.norm(dr.cross(unit(first.dc), unit(second.dc)))
        beyond_end = dr.maximum(1.5 * last.r * turn - dr.norm(last.dc), 0)
        return End(ring, ring.tangent * dr.select(begins, Float(1), -1), dr.fma(last.r, GAP, beyond_end))

    def controls(
        self, prim_index: UInt32, active: Bool | bool, controls: Float | Float64 | None = None
    ) -> list[Array4f]:
        """The four control points of a segment."""
        values = self.place() if controls is None else controls
        kind = Array4f if isinstance(values, Float) else Array4f64
        first = dr.gather(UInt32, self.shape.segment_indices, prim_index, active)
        return [Array4f(dr.gather(kind, values, first + k, active, mode=dr.ReduceMode.Local)) for k in range(4)]

    def chord(self, prim_index: UInt32, v: Float, points: list[Array4f], active: Bool | bool) -> tuple[Point3f, Float]:
        """The middle and the radius, at a parameter of a segment, of the straight piece that rays meet."""
        count = Float(dr.gather(UInt32, self.shape.piece_counts, prim_index, active))
        low = dr.floor(dr.clip(v * count, 0, count - 0.5))
        start, stop = (cubic_place(points, k / count) for k in (low, low + 1))
        along = v * count - low
        return dr.lerp(start.c, stop.c, along), dr.lerp(start.r, stop.r, along)

    def v(self, prim_index: UInt32, uv: Point2f) -> Float:
        """The parameter of a segment at texture coordinates."""
        return dr.fma(uv.y, self.shape.primitive_count(), -Float(prim_index))

    def uv(self, prim_index: UInt32, v: Float, phi: Float) -> Point2f:
        """The texture coordinates at a parameter of a segment and an angle."""
        turn = phi * (0.5 / math.pi)
        return Point2f(turn - dr.floor(turn), (v + Float(prim_index)) * (1 / self.shape.primitive_count()))

    def segment_at(self, fraction: Float) -> tuple[UInt32, Float]:
        """The segment, and the parameter in it, at a fraction of all segments."""
        return self._split(fraction, self.shape.primitive_count())

    def end_at(self, fraction: Float, active: Bool | bool) -> tuple[UInt32, Float, Float]:
        """The segment at an end of a curve, the parameter there, and the fraction of the circle, for one of all."""
        curve, within = self._split(fraction, self.shape.curve_count)
        end, turn = self._split(within, 2)
        first, last = self.segments_of(curve, active)
        return dr.select(end == 0, first, last), Float(end), turn

    @staticmethod
    def _split(fraction: Float, count: int) -> tuple[UInt32, Float]:
        """Which of so many equal parts a fraction lies in, and where in it."""
        along = fraction * count
        part = dr.minimum(UInt32(along), count - 1)
        return part, along - Float(part)

    def curve_of(self, prim_index: UInt32, active: Bool | bool) -> UInt32:
        """The curve that a segment belongs to."""
        first = self.shape.first_segments
        after = dr.binary_search(0, self.shape.curve_count, lambda k: dr.gather(UInt32, first, k, active) <= prim_index)
        return UInt32(after) - 1

    def segments_of(self, curve: UInt32, active: Bool | bool) -> tuple[UInt32, UInt32]:
        """The first and the last segment of a curve."""
        first, after = (dr.gather(UInt32, self.shape.first_segments, curve + k, active) for k in range(2))
        return first, after - 1

    # ---- silhouettes ----------------------------------------------------------------------

    def _on_end(
        self, prim_index: UInt32, v: Float, phi: Float, end: End, d: Vector3f, flags: int
    ) -> SilhouetteSample3f:
        """The point of an end's circle at an angle, with the direction d."""
        ring = end.ring
        out = ring.out(phi)
        tangent = dr.cross(out, ring.tangent)
        return self.sample_of(
            p=ring.point(out),
            n=edge_normal(d, tangent, end.inward),
            uv=self.uv(prim_index, v, phi),
            discontinuity_type=dr.select(ring.place.r > 0, UInt32(PERIMETER), 0),
            flags=UInt32(flags),
            d=d,
            silhouette_d=tangent,
            prim_index=prim_index,
            foreshortening=dr.norm(dr.cross(d, tangent)),
            gap=end.gap,
        )

    def _turning(
        self, prim_index: UInt32, v: Float, phi: Float, ring: Ring, points: list[Array4f], d: Vector3f, flags: int
    ) -> tuple[SilhouetteSample3f, Float]:
        """The point at an angle, where the direction d grazes the tube, and the length of the silhouette per v."""
        place, out = ring.place, ring.out(phi)
        b = dr.cross(ring.tangent, out)
        alpha, beta = ring.along(out)
        forward = ring.tangent * alpha + out * beta
        stretch = dr.maximum(dr.squared_norm(forward), 1e-30)
        k, speed = dr.dot(out, ring.turn), dr.norm(place.dc)
        faster = dr.dot(ring.tangent, place.ddc)
        third = vector(points[3] - points[0] + 3 * (points[1] - points[2]))
        turning = (dr.dot(out, third) - 2 * faster * k) * dr.rcp(dr.maximum(speed, 1e-30))
        around = -place.r * alpha
        mixed = place.r * beta * dr.dot(b, ring.turn)
        along = k * (dr.square(alpha) + 2 * dr.square(beta)) + beta * (place.r * turning - faster) + alpha * place.ddr
        x, y = dr.dot(d, b) * dr.rcp(dr.maximum(place.r, 1e-30)), dr.dot(d, forward) * dr.rcp(stretch)
        by_phi, by_v = -(mixed * x + along * y), around * x + mixed * y
        run = b * (place.r * by_phi) + forward * by_v
        length = dr.norm(run)
        curvature = -(around * x * x + 2 * mixed * x * y + along * y * y) * dr.rsqrt(stretch)
        ss = self.sample_of(
            p=ring.point(out),
            n=ring.normal(out),
            uv=self.uv(prim_index, v, phi),
            discontinuity_type=dr.select(place.r > 0, UInt32(INTERIOR), 0),
            flags=UInt32(flags),
            d=d,
            silhouette_d=run * dr.rcp(dr.maximum(length, 1e-30)),
            prim_index=prim_index,
            foreshortening=dr.abs(curvature),
            gap=place.r * GAP,
        )
        return ss, length * dr.rcp(dr.maximum(dr.abs(by_v), 1e-30))

    def sample(self, sample: Point3f, flags: int, active: Bool | bool) -> SilhouetteSample3f:
        if flags & PERIMETER:
            prim, v, turn = self.end_at(sample.x, active)
            phi = turn * (2 * math.pi)
            end = self.end(prim, v, active)
            ring = end.ring
            frame = Frame3f.from_normal(ring.normal(ring.out(phi)))
            local = square_to_uniform_hemisphere(Point2f(sample.y, sample.z))
            ss = self._on_end(prim, v, phi, end, -frame.to_world(local), flags)
            circles = 2 * math.pi * 2 * self.shape.curve_count * ring.place.r
            ss.pdf = square_to_uniform_hemisphere_pdf(local) * dr.select(ss.is_valid(), dr.rcp(circles), 0)
            return ss
        if not flags & INTERIOR:
            return SilhouetteSample3f()
        prim, v = self.segment_at(sample.x)
        phi = sample.y * (2 * math.pi)
        ring, points = self.ring(prim, v, active)
        out = ring.out(phi)
        d = interval_to_tangent_direction(ring.normal(out), sample.z)
        ss, _ = self._turning(prim, v, phi, ring, points, d, flags)
        alpha, beta = ring.along(out)
        area = ring.place.r * dr.sqrt(dr.square(alpha) + dr.square(beta))
        ss.pdf = dr.select(ss.is_valid(), dr.rcp(4 * math.pi**2 * self.shape.primitive_count() * area), 0)
        return ss

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool) -> Point3f:
        active = ss.is_valid() & active
        prim = dr.select(active, ss.prim_index, 0)
        v = self.v(prim, ss.uv)
        n = self._normal(prim, v, ss, active)
        square = uniform_hemisphere_to_square(-Frame3f.from_normal(n).to_local(ss.d))
        on_circle = 0.5 * (ss.uv.x + dr.select(v < 0.5, Float(0), 1))
        on_end = (on_circle + Float(self.curve_of(prim, active))) / self.shape.curve_count
        side = Point3f(ss.uv.y, ss.uv.x, tangent_direction_to_interval(n, ss.d))
        found = dr.select(ss.discontinuity_type == INTERIOR, side, Point3f(on_end, square.x, square.y))
        return dr.select(active, found, 0)

    # ---- as a viewer sees them --------------------------------------------------------------

    def project(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        prim, phi = UInt32(si.prim_index), si.uv.x * (2 * math.pi)
        if flags & PERIMETER:
            first, last = self.segments_of(self.curve_of(prim, active), active)
            begins = 2 * (Float(prim - first) + self.v(prim, si.uv)) < Float(last + 1 - first)
            end = dr.select(begins, first, last), dr.select(begins, Float(0), 1)
            ss = self._seen_end(viewpoint, *end, phi)
            ss.discontinuity_type = dr.select(self.stops(ss, active), ss.discontinuity_type, 0)
            return ss
        if not flags & INTERIOR:
            return SilhouetteSample3f()
        v = self.v(prim, si.uv)
        ring, points = self.ring(prim, v, active)
        w = ring.place.c - viewpoint
        # Of both sides the one that is closer to the point.
        side = dr.dot(dr.cross(w, ring.out(phi)), ring.tangent)
        return self._seen_turning(viewpoint, prim, v, side, ring, points)[0]

    def _seen_end(self, viewpoint: Point3f, prim_index: UInt32, v: Float, phi: Float) -> SilhouetteSample3f:
        """The point of an end at an angle."""
        end = self.end(prim_index, v, True)
        ring = end.ring
        d = dr.normalize(ring.point(ring.out(phi)) - viewpoint)
        ss = self._on_end(prim_index, v, phi, end, d, PERIMETER)
        ss.pdf = dr.select(ss.is_valid(), dr.rcp(2 * math.pi * ring.place.r), 0)
        return ss

    def _seen_turning(
        self, viewpoint: Point3f, prim_index: UInt32, v: Float, side: Float, ring: Ring, points: list[Array4f]
    ) -> tuple[SilhouetteSample3f, Float]:
        """The point where a circle's tube turns away, on one side, and the length of the silhouette per v.

        With w . a = W cos(psi), the angle psi from where the circle is farthest is found by Newton's method.
        """
        place = ring.place
        w = place.c - viewpoint
        x, y = dr.dot(w, ring.origin), dr.dot(w, ring.rotation)
        far = dr.maximum(dr.sqrt(dr.square(x) + dr.square(y)), 1e-30)
        speed, toward = dr.norm(place.dc), dr.dot(w, ring.tangent) * place.dr
        cos = (toward * dr.rcp(dr.maximum(speed, 1e-30)) - place.r) / far
        begin, psi = dr.atan2(y, x), dr.mulsign(dr.safe_acos(cos), side)
        found = dr.abs(cos) <= 1
        for _ in range(STEPS):
            out = ring.out(begin + psi)
            alpha, _ = ring.along(out)
            sin_psi, cos_psi = dr.sincos(psi)
            reach = dr.fma(far, cos_psi, place.r)
            rest = reach * alpha - toward
            slope = -far * sin_psi * alpha - reach * place.r * dr.dot(dr.cross(ring.tangent, out), ring.turn)
            step = rest / dr.select(dr.abs(slope) > 1e-20, slope, 1)
            psi = psi - dr.clip(step, -0.5, 0.5)
        phi = begin + psi
        out = ring.out(phi)
        alpha, _ = ring.along(out)
        rest = dr.fma(far, dr.cos(psi), place.r) * alpha - toward
        d = dr.normalize(ring.point(out) - viewpoint)
        ss, length = self._turning(prim_index, v, phi, ring, points, d, INTERIOR)
        found &= (dr.abs(rest) < 1e-4 * far * speed) & (alpha > 0)
        ss.discontinuity_type = dr.select(found, ss.discontinuity_type, 0)
        return ss, length

    def precompute(self, viewpoint: Point3f, creases: bool = False, within: float = 0.0) -> tuple[UInt32, Float]:
        return UInt32(PERIMETER, INTERIOR), Float(0.5, 0.5)

    def sample_precomputed(
        self, viewpoint: Point3f, part: UInt32, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        prim, v, turn = self.end_at(sample, active)
        rim = self._seen_end(viewpoint, prim, v, turn * (2 * math.pi))
        rim.pdf = rim.pdf / (2 * self.shape.curve_count)

        half, fraction = self._split(sample, 2)
        prim, v = self.segment_at(fraction)
        ring, points = self.ring(prim, v, active)
        side, length = self._seen_turning(viewpoint, prim, v, dr.select(half == 0, Float(1), -1), ring, points)
        total = 2 * self.shape.primitive_count() * length
        side.pdf = dr.select(side.is_valid(), dr.rcp(dr.maximum(total, 1e-30)), 0)
        found = dr.select(part == INTERIOR, side, rim)
        found.discontinuity_type = dr.select((part == INTERIOR) | (part == PERIMETER), found.discontinuity_type, 0)
        return found

    def _normal(self, prim_index: UInt32, v: Float, ss: SilhouetteSample3f, active: Bool | bool) -> Normal3f:
        """The normal of the tube at a silhouette."""
        phi = ss.uv.x * (2 * math.pi)
        ring, end = self.ring(prim_index, v, active)[0], self.end(prim_index, v, active).ring
        return dr.select(ss.discontinuity_type == INTERIOR, ring.normal(ring.out(phi)), end.normal(end.out(phi)))

    def stops(self, ss: SilhouetteSample3f, active: Bool | bool) -> Bool:
        n = self._normal(ss.prim_index, self.v(ss.prim_index, ss.uv), ss, active)
        return (ss.discontinuity_type == INTERIOR) | (dr.dot(n, ss.d) < 0)

    def foreground(self, ss: SilhouetteSample3f, active: Bool | bool) -> tuple[Point3f, Normal3f]:
        v, phi = self.v(ss.prim_index, ss.uv), ss.uv.x * (2 * math.pi)
        end, inward, _ = self.end(ss.prim_index, v, active)
        out = end.out(phi)
        n = end.normal(out)
        along = dr.normalize(dr.fma(n, -dr.dot(n, inward), inward)) * (INSET * end.place.r)
        # Outside of a bend rays pass the straight pieces before they graze the curve.
        ring, points = self.ring(ss.prim_index, v, active)
        c, r = self.chord(ss.prim_index, v, points, active)
        depth = dr.dot(ss.n, ss.p - dr.fma(ring.out(phi), r, c)) * dr.rcp(dr.maximum(ring.place.r, 1e-30))
        turned = phi + dr.mulsign(dr.safe_sqrt(2 * depth), -dr.dot(dr.cross(ring.tangent, ss.n), ss.d))
        side = ring.out(turned)
        on_end = ss.discontinuity_type == PERIMETER
        return dr.select(on_end, end.point(out) + along, ring.point(side)), dr.select(on_end, n, ring.normal(side))

    # ---- motion -------------------------------------------------------------------------------

    def follow(self, prim_index: UInt32, uv: Point2f, active: Bool | bool) -> Point3f | None:
        controls = self.attached()
        if controls is None:
            return None
        uv = dr.detach(uv)
        v, phi = self.v(prim_index, uv), uv.x * (2 * math.pi)
        ring, points = self.ring(prim_index, v, active, controls)
        end = self.end(prim_index, v, active, controls).ring
        # The distance of the straight pieces from the curve changes as it bends.
        ring.place.c, ring.place.r = self.chord(prim_index, v, points, active)
        rounding = dr.epsilon(Float) * (1 + self.shape.primitive_count())
        at_end = dr.abs(v - 0.5) > 0.5 - 4 * rounding
        return dr.select(at_end, end.point(end.out(phi)), ring.point(ring.out(phi)))

    def surface(self, place: Any, p: Point3f, prim_index: UInt32, active: Bool | bool) -> SurfacePoint:
        with dr.suspend_grad():
            still, here = dr.detach(place), dr.detach(p)
            v = Float(0.5)
            for _ in range(STEPS):
                ring, _ = self.ring(prim_index, v, active, still)
                v = dr.clip(v - dr.clip(beyond(ring, here), -0.5, 0.5), 0, 1)
        ring, points = self.ring(prim_index, v, active, place)
        v = v - beyond(ring, p)
        ring = Ring.of(cubic_place(points, v))
        out = unit(p - ring.place.c)
        n = ring.normal(out)
        around = dr.cross(ring.tangent, out) * (2 * math.pi * ring.place.r)
        turn = turns(dr.dot(ring.rotation, out), dr.dot(ring.origin, out))
        uv = Point2f(turn, (v + Float(prim_index)) * (1 / self.shape.primitive_count()))
        return SurfacePoint(n, n, uv, around)


def beyond(ring: Ring, p: Point3f) -> Float:
    """Newton's step from a circle towards the one whose plane holds a point, in v: what is to be taken off."""
    out = p - ring.place.c
    slope = dr.dot(out, ring.place.ddc) - dr.squared_norm(ring.place.dc)
    return dr.dot(out, ring.place.dc) / dr.select(dr.detach(slope) < 0, slope, -1)
