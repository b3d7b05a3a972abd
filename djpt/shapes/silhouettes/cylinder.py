"""Silhouettes of cylinders: the two rims, and the lines where the side turns away."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.core.records import SurfaceInteraction3f
from djpt.core.warp import (
    interval_to_tangent_direction,
    square_to_uniform_sphere,
    tangent_direction_to_interval,
    turns,
    uniform_sphere_to_square,
)
from djpt.jit.types import Bool, Float, Normal3f, Point2f, Point3f, UInt32, Vector2f, Vector3f
from djpt.shapes.silhouettes.base import (
    INSET,
    INTERIOR,
    PERIMETER,
    TURN,
    Placement,
    Silhouette,
    SurfacePoint,
    away_from,
    edge_normal,
    lets_through,
)
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["CylinderSilhouette"]


class CylinderSilhouette(Silhouette):
    """Both rims with all directions, or all points of the side, each with the directions of its tangent plane."""

    types = PERIMETER | INTERIOR
    offset = 1e-3

    def sample(self, sample: Point3f, flags: int, active: Bool | bool) -> SilhouetteSample3f:
        if flags & PERIMETER:
            lower = sample.x < 0.5
            turn = 2 * sample.x - dr.select(lower, Float(0), 1)
            d = square_to_uniform_sphere(Point2f(sample.y, sample.z))
            ss = self._on_rim(turn, dr.select(lower, Float(0), 1), lambda p: d, flags)
            ss.pdf = dr.rcp(16 * math.pi**2 * self.shape.radius)
            ss.foreshortening = dr.norm(dr.cross(ss.d, ss.silhouette_d))
            return ss
        if not flags & INTERIOR:
            return SilhouetteSample3f()
        ps = self.shape.draw_point(Point2f(sample.y, sample.z))
        n = ps.n * self.shape.side
        d = interval_to_tangent_direction(n, sample.x)
        ss = self._on_side(ps.p, n, ps.uv, d, flags)
        ss.pdf = ps.pdf * (0.5 / math.pi)
        ss.foreshortening = dr.squared_norm(dr.cross(d, ss.silhouette_d)) / self.shape.radius
        return ss

    def _on_rim(
        self, turn: Float, end: Float, direction: Callable[[Point3f], Vector3f], flags: int
    ) -> SilhouetteSample3f:
        """The point at an angle on the rim number `end`, and the `direction` that belongs to it."""
        shape = self.shape
        p = self._at(turn, end)
        d = direction(p)
        sin, cos = dr.sincos(2 * math.pi * turn)
        tangent = shape.axis_x * sin - shape.axis_y * cos
        inward = shape.axis_z * dr.fma(-2, end, 1)
        return self.sample_of(
            p=p,
            n=edge_normal(d, tangent, inward),
            uv=Point2f(turn, end),
            discontinuity_type=UInt32(PERIMETER),
            flags=UInt32(flags),
            d=d,
            silhouette_d=tangent,
        )

    def _on_side(self, p: Point3f, n: Vector3f, uv: Point2f, d: Vector3f, flags: int) -> SilhouetteSample3f:
        return self.sample_of(
            p=p,
            n=n,
            uv=uv,
            discontinuity_type=UInt32(INTERIOR),
            flags=UInt32(flags),
            d=d,
            silhouette_d=Vector3f(self.shape.axis_z),
        )

    def _at(self, turn: Float, height: Float) -> Point3f:
        """The point with the texture coordinates (turn, height)."""
        shape = self.shape
        along = shape.axis_z * ((height - 0.5) * shape.length)
        return dr.fma(shape.radial(turn), shape.radius, along + shape.center)

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool) -> Point3f:
        square = uniform_sphere_to_square(ss.d)
        on_rim = Point3f(0.5 * ss.uv.x + dr.select(ss.uv.y < 0.5, Float(0), 0.5), square.x, square.y)
        on_side = Point3f(tangent_direction_to_interval(ss.n, ss.d), ss.uv.y, ss.uv.x)
        found = dr.select(ss.discontinuity_type == INTERIOR, on_side, on_rim)
        return dr.select(ss.is_valid(), found, 0)

    def project(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        if flags & PERIMETER:
            return self._on_rim(si.uv.x, dr.select(si.uv.y > 0.5, Float(1), 0), away_from(viewpoint), flags)
        if not flags & INTERIOR:
            return SilhouetteSample3f()
        return self._turned_away(viewpoint, si.uv, flags)

    def _turned_away(self, viewpoint: Point3f, uv: Point2f, flags: int) -> SilhouetteSample3f:
        """The point at the height of `uv`, on that of the two lines which is on the same side of the viewer."""
        shape = self.shape
        across, _ = shape.across(viewpoint)
        x, y = dr.dot(across, shape.axis_x), dr.dot(across, shape.axis_y)
        distance = dr.norm(across)
        to_viewer = dr.atan2(y, x)
        sin, cos = dr.sincos(2 * math.pi * uv.x)
        # As in Mitsuba, which takes neither side where the point is exactly in front or behind.
        side = dr.sign(x * sin - y * cos)
        angle = dr.fma(dr.safe_acos(shape.radius / distance), side, to_viewer)
        turn = angle * (0.5 / math.pi)
        turn = turn - dr.floor(turn)
        p = self._at(turn, uv.y)
        ss = self._on_side(p, shape.radial(turn), Point2f(turn, uv.y), dr.normalize(p - viewpoint), flags)
        # From within there is no silhouette.
        ss.discontinuity_type = dr.select(distance > shape.radius, UInt32(INTERIOR), 0)
        return ss

    def precompute(self, viewpoint: Point3f, creases: bool = False, within: float = 0.0) -> tuple[UInt32, Float]:
        return UInt32(PERIMETER, INTERIOR), Float(0.5, 0.5)

    def sample_precomputed(
        self, viewpoint: Point3f, part: UInt32, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        second = sample > 0.5
        half = 2 * sample - dr.select(second, Float(1), 0)
        rim = self._on_rim(half, dr.select(second, Float(1), 0), away_from(viewpoint), PERIMETER)
        rim.pdf = dr.rcp(4 * math.pi * self.shape.radius)
        # Any two points that are half a turn apart: they lie on different sides of the viewer.
        turn = dr.select(second, Float(0.6), 0.1)
        side = self._turned_away(viewpoint, Point2f(turn, half), INTERIOR)
        side.pdf = dr.rcp(2 * self.shape.length)
        found = dr.select(part == INTERIOR, side, rim)
        found.discontinuity_type = dr.select((part == INTERIOR) | (part == PERIMETER), found.discontinuity_type, 0)
        return found

    def place(self) -> Placement:
        shape = self.shape
        x, y = shape.axis_x * shape.radius, shape.axis_y * shape.radius
        z = shape.axis_z * shape.length
        return Placement(x, y, z, shape.center - 0.5 * z)

    def surface(self, place: Any, p: Point3f, prim_index: UInt32, active: Bool | bool) -> SurfacePoint:
        local = place.along(p)
        n = dr.normalize(p - place.origin - place.z * local.z) * self.shape.side
        return SurfacePoint(n, n, Point2f(turns(local.y, local.x), local.z), place.around(local))

    def foreground(self, ss: SilhouetteSample3f, active: Bool | bool) -> tuple[Point3f, Normal3f]:
        place = self.place()
        p = dr.fma(place.z, INSET * (0.5 - ss.uv.y), ss.p)
        if lets_through(self.shape):
            local, d = place.along(p), place.along(place.origin + ss.d)
            rim, across = Vector2f(local.x, local.y), dr.normalize(Vector2f(d.x, d.y))
            turned = dr.normalize(rim - across * TURN)
            x, y = dr.select(ss.discontinuity_type == INTERIOR, turned, rim)
            p = place.point(Point3f(x, y, local.z))
        return p, self.surface(place, p, ss.prim_index, active).n

    def local(self, uv: Point2f) -> Point3f:
        sin, cos = dr.sincos(2 * math.pi * uv.x)
        return Point3f(cos, sin, uv.y)
