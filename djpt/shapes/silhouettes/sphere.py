"""Silhouettes of spheres: circles."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from djpt.core.frame import coordinate_system
from djpt.core.records import SurfaceInteraction3f
from djpt.core.warp import interval_to_tangent_direction, tangent_direction_to_interval, turns, uniform_sphere_to_square
from djpt.jit.types import Bool, Float, Normal3f, Point2f, Point3f, UInt32
from djpt.shapes.silhouettes.base import INTERIOR, TURN, Placement, Silhouette, SurfacePoint, lets_through
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["SphereSilhouette"]


class SphereSilhouette(Silhouette):
    """All points of the sphere, each with the directions of its tangent plane."""

    types = INTERIOR

    def sample(self, sample: Point3f, flags: int, active: Bool | bool) -> SilhouetteSample3f:
        if not flags & INTERIOR:
            return SilhouetteSample3f()
        ps = self.shape.draw_point(Point2f(sample.y, sample.z))
        n = -ps.n if self.shape.flip_normals else ps.n
        d = interval_to_tangent_direction(n, sample.x)
        return self.sample_of(
            p=ps.p,
            n=n,
            uv=ps.uv,
            pdf=ps.pdf * (0.5 / math.pi),
            discontinuity_type=UInt32(INTERIOR),
            flags=UInt32(flags),
            d=d,
            silhouette_d=dr.cross(d, n),
            foreshortening=dr.rcp(self.shape.radius),
        )

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool) -> Point3f:
        square = uniform_sphere_to_square(self.local(ss.uv))
        return Point3f(tangent_direction_to_interval(ss.n, ss.d), square.x, square.y)

    def project(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        if not flags & INTERIOR:
            return SilhouetteSample3f()
        # The silhouette is the circle whose angle from the viewer, seen from the centre, is acos(radius / distance).
        shape = self.shape
        to_viewer = viewpoint - shape.center
        distance = dr.norm(to_viewer)
        towards = to_viewer / distance
        across = dr.normalize(dr.fma(towards, -dr.dot(towards, si.n), si.n))
        cos = shape.radius / distance
        n = dr.normalize(towards * cos + across * dr.safe_sqrt(dr.fma(-cos, cos, 1)))
        p = dr.fma(n, shape.radius, shape.center)
        d = dr.normalize(p - viewpoint)
        return self.sample_of(
            p=p,
            n=n,
            uv=shape._uv(shape._to_local(n)),
            discontinuity_type=UInt32(INTERIOR),
            flags=UInt32(flags),
            d=d,
            silhouette_d=dr.cross(d, n),
        )

    def precompute(self, viewpoint: Point3f, creases: bool = False, within: float = 0.0) -> tuple[UInt32, Float]:
        return UInt32(INTERIOR), Float(1)

    def sample_precomputed(
        self, viewpoint: Point3f, part: UInt32, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        to_viewer = viewpoint - self.shape.center
        distance = dr.norm(to_viewer)
        towards = to_viewer / distance
        s, t = coordinate_system(towards)
        sin, cos = dr.sincos(2 * math.pi * sample)
        si = SurfaceInteraction3f(n=dr.normalize(towards + s * cos + t * sin))
        ss = self.project(viewpoint, si, INTERIOR, Float(0), active)
        ring = self.shape.radius / distance * dr.norm(ss.p - viewpoint)
        ss.pdf = dr.rcp(2 * math.pi * ring)
        return ss

    def place(self) -> Placement:
        shape = self.shape
        x, y, z = (axis * shape.radius for axis in (shape.axis_x, shape.axis_y, shape.axis_z))
        return Placement(x, y, z, shape.center)

    def surface(self, place: Any, p: Point3f, prim_index: UInt32, active: Bool | bool) -> SurfacePoint:
        n = dr.normalize(p - place.origin)
        n = -n if self.shape.flip_normals else n
        local = place.along(p)
        turn = turns(local.y, local.x)
        uv = Point2f(turn, dr.safe_acos(local.z * dr.rsqrt(dr.squared_norm(local))) / math.pi)
        return SurfacePoint(n, n, uv, place.around(local))

    def foreground(self, ss: SilhouetteSample3f, active: Bool | bool) -> tuple[Point3f, Normal3f]:
        shape = self.shape
        if not lets_through(shape):
            return ss.p, self.surface(self.place(), ss.p, ss.prim_index, active).n
        n = dr.normalize(ss.p - shape.center - ss.d * (TURN * shape.radius))
        p = dr.fma(n, shape.radius, shape.center)
        return p, self.surface(self.place(), p, ss.prim_index, active).n

    def local(self, uv: Point2f) -> Point3f:
        sin_phi, cos_phi = dr.sincos(2 * math.pi * uv.x)
        sin, cos = dr.sincos(math.pi * uv.y)
        return Point3f(sin * cos_phi, sin * sin_phi, cos)
