"""Silhouettes of rectangles: their four edges."""

from __future__ import annotations

import math
from collections.abc import Callable

import drjit as dr

from djpt.core.records import SurfaceInteraction3f
from djpt.core.warp import square_to_uniform_sphere, uniform_sphere_to_square
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector2f, Vector3f
from djpt.shapes.silhouettes.base import PERIMETER, Placement, away_from
from djpt.shapes.silhouettes.flat import FlatSilhouette
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["RectangleSilhouette"]

EDGES = (((0, 0), (0, 1)), ((0, 1), (1, 0)), ((1, 1), (0, -1)), ((1, 0), (-1, 0)))
"""Start and direction of the edges in uv, in the order in which samples run along them: clockwise."""


class RectangleSilhouette(FlatSilhouette):
    """The edges, each with the same probability and all directions."""

    def sample(self, sample: Point3f, flags: int, active: Bool | bool) -> SilhouetteSample3f:
        if not flags & PERIMETER:
            return SilhouetteSample3f()
        uv, direction = Point2f(0), Vector2f(0)
        for k, (start, along) in enumerate(EDGES):
            here = (sample.x >= 0.25 * k) if k == 3 else (sample.x >= 0.25 * k) & (sample.x < 0.25 * (k + 1))
            uv = dr.select(here, dr.fma(4 * Vector2f(along), sample.x - 0.25 * k, Point2f(start)), uv)
            direction = dr.select(here, Vector2f(along), direction)
        d = square_to_uniform_sphere(Point2f(sample.y, sample.z))
        ss, half_length = self._on_edge(uv, direction, lambda p: d, flags)
        ss.pdf = dr.rcp(half_length * (32 * math.pi))
        ss.foreshortening = dr.norm(dr.cross(ss.d, ss.silhouette_d))
        return ss

    def _on_edge(
        self, uv: Point2f, along_uv: Vector2f, direction: Callable[[Point3f], Vector3f], flags: int
    ) -> tuple[SilhouetteSample3f, Float]:
        """The point at `uv` on the edge along `along_uv`, and the `direction` that belongs to it; half of the edge."""
        shape = self.shape
        outward = shape.edge_u * dr.fma(2, uv.x, -1) + shape.edge_v * dr.fma(2, uv.y, -1)
        along = shape.edge_u * along_uv.x + shape.edge_v * along_uv.y
        return self._on_perimeter(outward, along, uv, direction, flags)

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool) -> Point3f:
        u, v = ss.uv.x, ss.uv.y
        along = dr.select(
            u == 0, v, dr.select(v == 1, 1 + u, dr.select(u == 1, 3 - v, dr.select(v == 0, 4 - u, Float(0))))
        )
        square = uniform_sphere_to_square(ss.d)
        return Point3f(0.25 * along, square.x, square.y)

    def project(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        if not flags & PERIMETER:
            return SilhouetteSample3f()
        return self._nearest(viewpoint, si.uv, flags, sample)[0]

    def _nearest(self, viewpoint: Point3f, uv: Point2f, flags: int, sample: Float) -> tuple[SilhouetteSample3f, Float]:
        """A uniform point of the edge that `uv` is nearest to, and half of the edge's length."""
        above, left = uv.y > 1 - uv.x, uv.y > uv.x
        # Coordinates on edges are 0 and 1 exactly: `invert` looks at them.
        horizontal = above == left
        side = dr.select(above, Float(1), 0)
        on_edge = dr.select(horizontal, Point2f(sample, side), Point2f(side, sample))
        direction = dr.select(horizontal, Vector2f(1, 0), Vector2f(0, 1))
        return self._on_edge(on_edge, direction, away_from(viewpoint), flags)

    def sample_precomputed(
        self, viewpoint: Point3f, part: UInt32, sample: Float, active: Bool | bool
    ) -> SilhouetteSample3f:
        edge = dr.minimum(UInt32(4 * sample), 3)
        middle = dr.select(
            edge == 0,
            Point2f(0, 0.5),
            dr.select(edge == 1, Point2f(0.5, 1), dr.select(edge == 2, Point2f(1, 0.5), Point2f(0.5, 0))),
        )
        ss, half_length = self._nearest(viewpoint, middle, PERIMETER, 4 * sample - Float(edge))
        # The density that belongs to the choice, whereas Mitsuba 3.9.1 divides by the diagonal of `to_world`.
        ss.pdf = dr.rcp(8 * half_length)
        return ss

    def uv_at(self, x: Float, y: Float) -> Point2f:
        return Point2f(dr.fma(0.5, x, 0.5), dr.fma(0.5, y, 0.5))

    def along_u(self, place: Placement, x: Float, y: Float) -> Vector3f:
        return 2 * place.x

    def local(self, uv: Point2f) -> Point3f:
        return Point3f(dr.fma(2, uv.x, -1), dr.fma(2, uv.y, -1), 0)
