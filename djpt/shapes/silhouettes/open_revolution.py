"""Silhouettes of surfaces of revolution that begin at a tip and end at a rim: cones and paraboloids."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
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

__all__ = ["Bend", "OpenRevolutionSilhouette"]


@dataclass
class Bend:
    """How a surface bends at a point: the unit normal away from the axis, and the principal directions."""

    n: Normal3f
    around: Vector3f
    """The unit direction around the axis."""
    outward: Vector3f
    """That away from the tip."""
    across_curvature: Float
    """The normal curvature around the axis."""
    along_curvature: Float
    """That away from the tip."""


class OpenRevolutionSilhouette(Silhouette):
    """The rim with all directions, or all points of the surface, each with the directions of its tangent plane.

    uv = (phi / 2 pi, v), with v from 0 at the tip to 1 at the rim.
    """

    types = PERIMETER | INTERIOR
    offset = 1e-3

    # ---- what each surface knows --------------------------------------------------------

    def profile(self, v: Float) -> tuple[Float, Float]:
        """The distance from the axis, and the place along it from the tip."""
        raise NotImplementedError

    def slope(self, v: Float) -> Float:
        """The change of the place along the axis with the distance from it."""
        raise NotImplementedError

    def along_curvature(self, v: Float) -> Float:
        """The curvature of the profile."""
        raise NotImplementedError

    def square_of(self, uv: Point2f) -> Point2f:
        """The point of the unit square that the shape's `draw_point` takes to `uv`."""
        raise NotImplementedError

    def turned_away(self, viewpoint: Point3f, uv: Point2f) -> tuple[Point2f, Bool]:
        """A place on the silhouette of the surface that belongs to `uv`, and whether there is one."""
        raise NotImplementedError

    def drawn_along(self, viewpoint: Point3f, sample: Float) -> tuple[Point2f, Float, Bool]:
        """A random place on the silhouette of the surface, its density per unit length, and whether there is one."""
        raise NotImplementedError

    def unit_gradient(self, p: Point3f) -> Vector3f:
        """The outward gradient of the function whose zeros the unit shape is."""
        raise NotImplementedError

    # ---- points -------------------------------------------------------------------------

    def _at(self, uv: Point2f) -> Point3f:
        """The point with the texture coordinates `uv`."""
        shape = self.shape
        r, z = self.profile(uv.y)
        return Point3f(dr.fma(shape.radial(uv.x), r, dr.fma(shape.axis_z, z, shape.center)))

    def bend(self, uv: Point2f) -> Bend:
        """How the surface bends at a point."""
        shape = self.shape
        radial = shape.radial(uv.x)
        rise = self.slope(uv.y)
        cos = dr.rsqrt(dr.fma(rise, rise, 1))
        outward = (radial + shape.axis_z * rise) * cos
        n = (radial * rise - shape.axis_z) * cos
        r = self.profile(uv.y)[0]
        return Bend(n, dr.cross(shape.axis_z, radial), outward, rise * cos / r, self.along_curvature(uv.y))

    def sample(self, sample: Point3f, flags: int, active: Bool | bool) -> SilhouetteSample3f:
        if flags & PERIMETER:
            d = square_to_uniform_sphere(Point2f(sample.y, sample.z))
            ss = self._on_rim(sample.x, lambda p: d, flags)
            ss.pdf = dr.rcp(8 * math.pi**2 * self.profile(Float(1))[0])
            ss.foreshortening = dr.norm(dr.cross(ss.d, ss.silhouette_d))
            return ss
        if not flags & INTERIOR:
            return SilhouetteSample3f()
        ps = self.shape.draw_point(Point2f(sample.y, sample.z))
        bend = self.bend(ps.uv)
        d = interval_to_tangent_direction(bend.n, sample.x)
        ss = self._on_side(ps.uv, d, flags)
        ss.pdf = ps.pdf * (0.5 / math.pi)
        x, y = dr.dot(d, bend.around), dr.dot(d, bend.outward)
        ss.foreshortening = dr.square(x) * bend.across_curvature + dr.square(y) * bend.along_curvature
        return ss

    def _on_rim(self, turn: Float, direction: Callable[[Point3f], Vector3f], flags: int) -> SilhouetteSample3f:
        """The point of the rim at an angle, and the `direction` that belongs to it."""
        uv = Point2f(turn, 1)
        p, bend = self._at(uv), self.bend(uv)
        d = direction(p)
        return self.sample_of(
            p=p,
            n=edge_normal(d, bend.around, -bend.outward),
            uv=uv,
            discontinuity_type=UInt32(PERIMETER),
            flags=UInt32(flags),
            d=d,
            silhouette_d=bend.around,
        )

    def _on_side(self, uv: Point2f, d: Vector3f, flags: int) -> SilhouetteSample3f:
        """The point with the texture coordinates `uv`, where `d` grazes the surface.

        The silhouette runs in the direction that is conjugate to `d`: the normal stays perpendicular to `d`.
        """
        bend = self.bend(uv)
        x, y = dr.dot(d, bend.around) * bend.across_curvature, dr.dot(d, bend.outward) * bend.along_curvature
        return self.sample_of(
            p=self._at(uv),
            n=bend.n,
            uv=uv,
            discontinuity_type=UInt32(INTERIOR),
            flags=UInt32(flags),
            d=d,
            silhouette_d=dr.normalize(bend.outward * x - bend.around * y),
        )

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool) -> Point3f:
        square = uniform_sphere_to_square(ss.d)
        on_rim = Point3f(ss.uv.x, square.x, square.y)
        place = self.square_of(ss.uv)
        on_side = Point3f(tangent_direction_to_interval(ss.n, ss.d), place.x, place.y)
        found = dr.select(ss.discontinuity_type == INTERIOR, on_side, on_rim)
        return dr.select(ss.is_valid(), found, 0)

    def project(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        if flags & PERIMETER:
            return self._on_rim(si.uv.x, away_from(viewpoint), flags)
        if not flags & INTERIOR:
            return SilhouetteSample3f()
        return self._seen_side(viewpoint, *self.turned_away(viewpoint, si.uv), flags)

    def _seen_side(self, viewpoint: Point3f, uv: Point2f, found: Bool, flags: int) -> SilhouetteSample3f:
        ss = self._on_side(uv, dr.normalize(self._at(uv) - viewpoint), flags)
        ss.discontinuity_type = dr.select(found, UInt32(INTERIOR), 0)
        return ss

    def local_viewpoint(self, viewpoint: Point3f) -> tuple[Vector3f, Float]:
        """The vector from the axis to the viewer, in the shape's x and y, and its place along the axis."""
        across, z = self.shape.across(viewpoint)
        return Vector3f(dr.dot(across, self.shape.axis_x), dr.dot(across, self.shape.axis_y), 0), z

    def precompute(self, viewpoint: Point3f, creases: bool = False, within: float = 0.0) -> tuple[UInt32, Float]:
        return UInt32(PERIMETER, INTERIOR), Float(0.5, 0.5)

    def sample_precomputed(
        self, viewpoint: Point3f, part: UInt32, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        rim = self._on_rim(sample, away_from(viewpoint), PERIMETER)
        rim.pdf = dr.rcp(2 * math.pi * self.profile(Float(1))[0])
        uv, pdf, found = self.drawn_along(viewpoint, sample)
        side = self._seen_side(viewpoint, uv, found, INTERIOR)
        side.pdf = dr.select(found, pdf, 0)
        result = dr.select(part == INTERIOR, side, rim)
        result.discontinuity_type = dr.select((part == INTERIOR) | (part == PERIMETER), result.discontinuity_type, 0)
        return result

    # ---- motion --------------------------------------------------------------------------

    def place(self) -> Placement:
        shape = self.shape
        r, z = self.profile(Float(1))
        return Placement(shape.axis_x * r, shape.axis_y * r, shape.axis_z * z, Point3f(shape.center))

    def surface(self, place: Any, p: Point3f, prim_index: UInt32, active: Bool | bool) -> SurfacePoint:
        local = place.along(p)
        gradient = self.unit_gradient(local)
        axes = zip((place.x, place.y, place.z), gradient, strict=True)
        n = dr.normalize(sum((axis * (g / dr.squared_norm(axis)) for axis, g in axes), Vector3f(0))) * self.shape.side
        uv = Point2f(turns(local.y, local.x), dr.norm(Point2f(local.x, local.y)))
        return SurfacePoint(n, n, uv, place.around(local))

    def foreground(self, ss: SilhouetteSample3f, active: Bool | bool) -> tuple[Point3f, Normal3f]:
        uv = Point2f(ss.uv.x, dr.fma(INSET, 0.5 - ss.uv.y, ss.uv.y))
        if lets_through(self.shape):
            place = self.place()
            local, d = place.along(self._at(uv)), place.along(place.origin + ss.d)
            x, y = Vector2f(local.x, local.y) - dr.normalize(Vector2f(d.x, d.y)) * TURN
            turned = Point2f(turns(y, x), dr.minimum(dr.norm(Point2f(x, y)), 1 - INSET))
            uv = dr.select(ss.discontinuity_type == INTERIOR, turned, uv)
        return self._at(uv), self.bend(uv).n * self.shape.side
