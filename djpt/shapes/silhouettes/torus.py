"""Silhouettes of tori: two closed curves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import SurfaceInteraction3f
from djpt.core.warp import interval_to_tangent_direction, tangent_direction_to_interval, turns
from djpt.jit.types import Bool, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.silhouettes.base import INTERIOR, TURN, Placement, Silhouette, SurfacePoint, lets_through
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["TorusSilhouette"]


@dataclass
class Bend:
    """How a torus bends at a point: all in local coordinates."""

    p: Point3f
    n: Vector3f
    """The outward unit normal."""
    along: Vector3f
    """The unit direction around the axis."""
    around: Vector3f
    """That around the tube, towards larger angles."""
    along_curvature: Float
    """The normal curvature around the axis: negative on the inner side."""
    around_curvature: Float


@dataclass
class Contour:
    """A point of the silhouette that a viewer sees, in local coordinates."""

    uv: Point2f
    tangent: Vector3f
    """The change of the point with the sample."""
    found: Bool


class TorusSilhouette(Silhouette):
    """All points of the torus, each with the directions of its tangent plane; uv = (phi / 2 pi, psi / 2 pi).

    With R and r the radii and e = (cos phi, sin phi, 0), the half plane at the angle phi cuts the torus in the circle
    R e + r n, n = cos psi e + sin psi z. A point of it is on the silhouette as seen from v if <R e + r n - v, n> = 0:

        a cos psi + b sin psi = -r,    a = R - <v, e>,  b = -v_z.

    This has two solutions if a^2 + b^2 > r^2, else none. Along directions in which the torus bends inwards, its
    silhouettes are seen from inside only.
    """

    types = INTERIOR
    offset = 1e-3

    # ---- points -------------------------------------------------------------------------

    def bend(self, uv: Point2f) -> Bend:
        """How the surface bends at a point."""
        major, minor = self.shape.major, self.shape.minor
        sin_phi, cos_phi = dr.sincos(2 * math.pi * uv.x)
        sin, cos = dr.sincos(2 * math.pi * uv.y)
        n = Vector3f(cos * cos_phi, cos * sin_phi, sin)
        rim = dr.fma(minor, cos, major)
        return Bend(
            p=Point3f(rim * cos_phi, rim * sin_phi, minor * sin),
            n=n,
            along=Vector3f(-sin_phi, cos_phi, 0),
            around=Vector3f(-sin * cos_phi, -sin * sin_phi, cos),
            along_curvature=cos / rim,
            around_curvature=dr.rcp(minor),
        )

    def _segment(self, uv: Point2f, d: Vector3f, flags: int, found: Bool) -> SilhouetteSample3f:
        """The point at `uv`, where `d` grazes the surface.

        The silhouette runs in the direction t that is conjugate to d, II(d, t) = 0. Affine maps keep such directions,
        and with the matrix M the curvature along d is II(M^-1 d, M^-1 d) / |M^-T n|.
        """
        shape, bend = self.shape, self.bend(uv)
        local = shape.to_local(d)
        x, y = dr.dot(local, bend.along), dr.dot(local, bend.around)
        n = shape.normal_to_world(bend.n)
        shrink = dr.rsqrt(dr.squared_norm(n))
        curvature = (dr.square(x) * bend.along_curvature + dr.square(y) * bend.around_curvature) * shrink
        conjugate = bend.around * (x * bend.along_curvature) - bend.along * (y * bend.around_curvature)
        return self.sample_of(
            p=shape.center + shape.to_world_vector(bend.p),
            n=Normal3f(n * dr.mulsign(shrink, curvature)),
            uv=uv,
            discontinuity_type=dr.select(found, UInt32(INTERIOR), 0),
            flags=UInt32(flags),
            d=d,
            silhouette_d=dr.normalize(shape.to_world_vector(conjugate)),
            foreshortening=dr.abs(curvature),
        )

    def _outward(self, bend: Bend) -> Normal3f:
        return Normal3f(dr.normalize(self.shape.normal_to_world(bend.n)))

    def sample(self, sample: Point3f, flags: int, active: Bool | bool) -> SilhouetteSample3f:
        if not flags & INTERIOR:
            return SilhouetteSample3f()
        uv = Point2f(sample.y, sample.z)
        bend = self.bend(uv)
        ss = self._segment(uv, interval_to_tangent_direction(self._outward(bend), sample.x), flags, Bool(True))
        along = self.shape.to_world_vector(
            bend.along * (self.shape.major + self.shape.minor * dr.cos(2 * math.pi * uv.y))
        )
        around = self.shape.to_world_vector(bend.around * self.shape.minor)
        ss.pdf = dr.rcp(8 * math.pi**3 * dr.norm(dr.cross(along, around)))
        return ss

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool) -> Point3f:
        return Point3f(tangent_direction_to_interval(self._outward(self.bend(ss.uv)), ss.d), ss.uv.x, ss.uv.y)

    # ---- as a viewer sees them ----------------------------------------------------------

    def project(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        if not flags & INTERIOR:
            return SilhouetteSample3f()
        minor = self.shape.minor
        v = self.shape.local_point(viewpoint)
        sin, cos = dr.sincos(2 * math.pi * si.uv.x)
        a, b = self.shape.major - dr.fma(v.x, cos, v.y * sin), -v.z
        squared = dr.fma(a, a, b * b)
        # Of both solutions the one that is closer to the point.
        side = dr.mulsign(dr.safe_sqrt(squared - dr.square(minor)), dr.sin(2 * math.pi * si.uv.y - dr.atan2(b, a)))
        uv = Point2f(si.uv.x, turns(dr.fma(a, side, -b * minor), -dr.fma(b, side, a * minor)))
        return self._seen(viewpoint, uv, squared > dr.square(minor))

    def _seen(self, viewpoint: Point3f, uv: Point2f, found: Bool) -> SilhouetteSample3f:
        p = self.shape.center + self.shape.to_world_vector(self.bend(uv).p)
        return self._segment(uv, dr.normalize(p - viewpoint), INTERIOR, found)

    def precompute(self, viewpoint: Point3f, creases: bool = False, within: float = 0.0) -> tuple[UInt32, Float]:
        return UInt32(INTERIOR), Float(1)

    def sample_precomputed(
        self, viewpoint: Point3f, part: UInt32, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        contour = self._contour(self.shape.local_point(viewpoint), sample)
        ss = self._seen(viewpoint, contour.uv, contour.found & (part == INTERIOR))
        tangent = self.shape.to_world_vector(contour.tangent)
        ss.pdf = dr.select(ss.is_valid(), dr.rcp(dr.norm(tangent)), 0)
        ss.silhouette_d = dr.normalize(tangent)
        return ss

    def _contour(self, v: Point3f, sample: Float) -> Contour:
        """A point of one curve for samples below 1/2, and of the other one above.

        Where the viewer is within r of the plane of the ring, half planes for which a^2 + b^2 < r^2 part the
        silhouette into a curve in front of the axis and one behind it. With delta the angle from the viewer and
        rho cos A = R +- sqrt(r^2 - v_z^2), they lie in abs(delta) <= A and abs(pi - delta) <= pi - A; both solutions
        of psi meet at the ends, so delta = A sin(theta) follows them smoothly. Else the curves are the two solutions
        for all angles.
        """
        major, minor = self.shape.major, self.shape.minor
        second = sample >= 0.5
        theta = 4 * math.pi * sample
        rho = dr.norm(Point2f(v.x, v.y))
        height = dr.square(minor) - dr.square(v.z)
        half_width = dr.safe_sqrt(height)
        low, high = major - half_width, major + half_width
        parted = (height > 0) & (rho > low)
        # The half plane turned by pi about the axis sees the viewer at -rho.
        sin_theta, cos_theta = dr.sincos(theta)
        toward = dr.select(second, -rho, rho)
        reach = dr.safe_acos(dr.select(second, -low, high) / rho)
        turned = dr.select(parted, reach * sin_theta, theta)
        sin_turned, cos_turned = dr.sincos(turned)
        sign = dr.select(parted, dr.mulsign(Float(1), cos_theta), dr.select(second, Float(-1), Float(1)))
        toward = dr.select(parted, toward, rho)
        a, b = major - toward * cos_turned, -v.z
        # root^2 = a^2 + b^2 - r^2 = (a - w) (a + w). Where curves are parted, one factor vanishes like cos(theta)^2.
        near, far = 0.5 * (1 - sin_theta), 0.5 * (1 + sin_theta)
        stretch = 0.5 * rho * dr.square(reach) * sinc(reach * near) * sinc(reach * far)
        other = dr.abs(a + dr.select(second, half_width, -half_width))
        slope = dr.sqrt(stretch * other)
        root = dr.select(parted, slope * dr.abs(cos_theta), dr.safe_sqrt(dr.fma(a, a, dr.fma(b, b, -dr.square(minor)))))
        inverse = dr.rcp(dr.fma(a, a, b * b))
        side = sign * root
        cos, sin = -dr.fma(b, side, a * minor) * inverse, dr.fma(a, side, -b * minor) * inverse
        # By theta: delta' / root, and delta', without their zeros in the first.
        per_root = dr.select(parted, reach / slope, dr.rcp(side))
        by_delta = dr.select(parted, reach * cos_theta, 1)
        phi = dr.atan2(v.y, v.x) + turned + dr.select(parted & second, Float(math.pi), 0)
        sin_phi, cos_phi = dr.sincos(phi)
        along, around = Vector3f(-sin_phi, cos_phi, 0), Vector3f(-sin * cos_phi, -sin * sin_phi, cos)
        tangent = along * (dr.fma(minor, cos, major) * by_delta) + around * (
            minor * toward * sin_turned * cos * per_root
        )
        return Contour(
            Point2f(turns(sin_phi, cos_phi), turns(sin, cos)), tangent * (4 * math.pi), ~parted | second | (rho > high)
        )

    # ---- motion --------------------------------------------------------------------------

    def place(self) -> Placement:
        shape = self.shape
        return Placement(shape.edge_x, shape.edge_y, shape.edge_z, Point3f(shape.center))

    def surface(self, place: Any, p: Point3f, prim_index: UInt32, active: Bool | bool) -> SurfacePoint:
        duals = dr.cross(place.y, place.z), dr.cross(place.z, place.x), dr.cross(place.x, place.y)
        scale = dr.rcp(dr.dot(place.x, duals[0]))
        v = p - place.origin
        local = Point3f(*(dr.dot(v, dual) * scale for dual in duals))
        from_ring = local - self._ring(local)
        n = dr.normalize((duals[0] * from_ring.x + duals[1] * from_ring.y + duals[2] * from_ring.z) * scale)
        n = -n if self.shape.flip_normals else n
        return SurfacePoint(Normal3f(n), Normal3f(n), self.shape.local_uv(local), place.around(local))

    def _ring(self, local: Point3f) -> Vector3f:
        """The point of the tube's middle that is closest to a local point."""
        stretch = self.shape.major * dr.rsqrt(dr.fma(local.x, local.x, dr.square(local.y)))
        return Vector3f(local.x * stretch, local.y * stretch, 0)

    def foreground(self, ss: SilhouetteSample3f, active: Bool | bool) -> tuple[Point3f, Normal3f]:
        shape = self.shape
        p = Point3f(ss.p)
        if lets_through(shape):
            local = shape.local_point(ss.p) - dr.normalize(shape.to_local(ss.d)) * (TURN * shape.minor)
            ring = self._ring(local)
            local = dr.fma(dr.normalize(local - ring), shape.minor, ring)
            p = shape.center + shape.to_world_vector(local)
        return p, self.surface(self.place(), p, ss.prim_index, active).n

    def local(self, uv: Point2f) -> Point3f:
        return self.bend(uv).p


def sinc(x: Float) -> Float:
    """sin(x) / x."""
    return dr.select(dr.abs(x) > 1e-3, dr.sin(x) / x, 1)
