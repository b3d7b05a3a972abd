"""Silhouettes of disks: their rims."""

from __future__ import annotations

import math
from collections.abc import Callable

import drjit as dr

from djpt.core.records import SurfaceInteraction3f
from djpt.core.warp import square_to_uniform_sphere, turns, uniform_sphere_to_square
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.silhouettes.base import PERIMETER, Placement, away_from
from djpt.shapes.silhouettes.flat import FlatSilhouette
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["DiskSilhouette"]


class DiskSilhouette(FlatSilhouette):
    """The rim, each point with all directions; uv = (1, phi / 2 pi)."""

    def sample(self, sample: Point3f, flags: int, active: Bool | bool) -> SilhouetteSample3f:
        if not flags & PERIMETER:
            return SilhouetteSample3f()
        d = square_to_uniform_sphere(Point2f(sample.y, sample.z))
        ss, speed = self._on_rim(sample.x, lambda p: d, flags)
        ss.pdf = dr.rcp(8 * math.pi**2 * speed)
        ss.foreshortening = dr.norm(dr.cross(ss.d, ss.silhouette_d))
        return ss

    def _on_rim(
        self, turn: Float, direction: Callable[[Point3f], Vector3f], flags: int
    ) -> tuple[SilhouetteSample3f, Float]:
        """The point at an angle, and the `direction` that belongs to it; and the length of dp/d(angle)."""
        shape = self.shape
        sin, cos = dr.sincos(2 * math.pi * turn)
        outward = shape.edge_u * cos + shape.edge_v * sin
        along = shape.edge_u * sin - shape.edge_v * cos
        return self._on_perimeter(outward, along, Point2f(1, turn), direction, flags)

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool) -> Point3f:
        square = uniform_sphere_to_square(ss.d)
        return Point3f(ss.uv.y, square.x, square.y)

    def project(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        if not flags & PERIMETER:
            return SilhouetteSample3f()
        return self._on_rim(si.uv.y, away_from(viewpoint), flags)[0]

    def sample_precomputed(
        self, viewpoint: Point3f, part: UInt32, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        ss, speed = self._on_rim(sample, away_from(viewpoint), PERIMETER)
        ss.pdf = dr.rcp(2 * math.pi * speed)
        return ss

    def uv_at(self, x: Float, y: Float) -> Point2f:
        return Point2f(dr.norm(Point2f(x, y)), turns(y, x))

    def along_u(self, place: Placement, x: Float, y: Float) -> Vector3f:
        return (place.x * x + place.y * y) * dr.rsqrt(dr.fma(x, x, dr.square(y)))

    def local(self, uv: Point2f) -> Point3f:
        sin, cos = dr.sincos(2 * math.pi * uv.y)
        return Point3f(uv.x * cos, uv.x * sin, 0)
