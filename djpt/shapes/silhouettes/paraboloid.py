"""Silhouettes of paraboloids: the rim, and the part of a plane curve that lies below it."""

from __future__ import annotations

import math

import drjit as dr

from djpt.core.warp import turns
from djpt.jit.types import Bool, Float, Point2f, Point3f, Vector3f
from djpt.shapes.silhouettes.open_revolution import OpenRevolutionSilhouette

__all__ = ["ParaboloidSilhouette"]


class ParaboloidSilhouette(OpenRevolutionSilhouette):
    """The rim and the side; uv = (phi / 2 pi, r / r of the rim).

    A point p is on the silhouette as seen from v if <p - v, (p_x, p_y, -2 f)> = 0. With p_x^2 + p_y^2 = 4 f p_z, these
    points lie above the circle abs(p_xy - v_xy)^2 = abs(v_xy)^2 - 4 f v_z.
    """

    def profile(self, v: Float) -> tuple[Float, Float]:
        r = v * self.shape.radius
        return r, dr.square(r) * dr.rcp(4 * self.shape.focal_length)

    def slope(self, v: Float) -> Float:
        return v * self.shape.radius * dr.rcp(2 * self.shape.focal_length)

    def along_curvature(self, v: Float) -> Float:
        inverse = dr.rsqrt(dr.fma(self.slope(v), self.slope(v), 1))
        return dr.rcp(2 * self.shape.focal_length) * inverse * inverse * inverse

    def square_of(self, uv: Point2f) -> Point2f:
        stretched = dr.fma(self.slope(uv.y), self.slope(uv.y), 1)
        return Point2f((stretched * dr.sqrt(stretched) - 1) / self.shape.growth, uv.x)

    def _circle(self, viewpoint: Point3f) -> tuple[Vector3f, Float, Bool]:
        """The middle of the circle in the shape's x and y, its radius, and whether there is one."""
        middle, z = self.local_viewpoint(viewpoint)
        squared = dr.squared_norm(middle) - 4 * self.shape.focal_length * z
        return middle, dr.safe_sqrt(squared), squared > 0

    def _above(self, x: Float, y: Float, found: Bool) -> tuple[Point2f, Bool]:
        """The place above a point of the plane of the vertex, and whether it lies below the rim."""
        v = dr.norm(Point2f(x, y)) / self.shape.radius
        return Point2f(turns(y, x), v), found & (v <= 1)

    def turned_away(self, viewpoint: Point3f, uv: Point2f) -> tuple[Point2f, Bool]:
        middle, radius, found = self._circle(viewpoint)
        sin, cos = dr.sincos(2 * math.pi * uv.x)
        r = uv.y * self.shape.radius
        x, y = r * cos - middle.x, r * sin - middle.y
        stretch = radius * dr.rsqrt(dr.fma(x, x, y * y))
        return self._above(dr.fma(x, stretch, middle.x), dr.fma(y, stretch, middle.y), found)

    def drawn_along(self, viewpoint: Point3f, sample: Float) -> tuple[Point2f, Float, Bool]:
        middle, radius, found = self._circle(viewpoint)
        # Only the arc around the axis can lie below the rim: it ends where both circles meet. Seen from far away both
        # the distance of the middle and the radius are large, and their difference is computed from 4 f z.
        distance = dr.norm(middle)
        toward = dr.select(distance > 0, middle / distance, Vector3f(1, 0, 0))
        gap = 4 * self.shape.focal_length * self.local_viewpoint(viewpoint)[1] / (distance + radius)
        reach = (dr.square(self.shape.radius) - dr.square(gap)) / (4 * distance * radius)
        half = 2 * dr.safe_asin(dr.sqrt(dr.clip(reach, 0, 1)))
        angle = half * dr.fma(2, sample, -1)
        sin = dr.sin(angle)
        ahead, aside = dr.fma(2 * radius, dr.square(dr.sin(0.5 * angle)), gap), radius * sin
        x, y = dr.fma(toward.x, ahead, toward.y * aside), dr.fma(toward.y, ahead, -toward.x * aside)
        uv, below = self._above(x, y, found & (reach > 0))
        # The curve rises by z = r^2 / (4 f) as the circle is followed.
        rise = distance * sin * dr.rcp(2 * self.shape.focal_length)
        return uv, dr.rcp(2 * half * radius * dr.sqrt(dr.fma(rise, rise, 1))), below

    def unit_gradient(self, p: Point3f) -> Vector3f:
        return Vector3f(2 * p.x, 2 * p.y, -1)

    def local(self, uv: Point2f) -> Point3f:
        sin, cos = dr.sincos(2 * math.pi * uv.x)
        return Point3f(uv.y * cos, uv.y * sin, dr.square(uv.y))
