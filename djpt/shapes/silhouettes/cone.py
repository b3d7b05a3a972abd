"""Silhouettes of cones: the rim, and two straight lines from the apex."""

from __future__ import annotations

import math

import drjit as dr

from djpt.jit.types import Bool, Float, Point2f, Point3f, Vector3f
from djpt.shapes.silhouettes.open_revolution import OpenRevolutionSilhouette

__all__ = ["ConeSilhouette"]


class ConeSilhouette(OpenRevolutionSilhouette):
    """The rim and the side; uv = (phi / 2 pi, z / length)."""

    def profile(self, v: Float) -> tuple[Float, Float]:
        z = v * self.shape.length
        return z * self.shape.slope, z

    def slope(self, v: Float) -> Float:
        return dr.rcp(self.shape.slope)

    def along_curvature(self, v: Float) -> Float:
        return Float(0)

    def square_of(self, uv: Point2f) -> Point2f:
        return Point2f(dr.square(uv.y), uv.x)

    def _lines(self, viewpoint: Point3f) -> tuple[Float, Float, Bool]:
        """The angle of the viewer, half of that between both lines, and whether there are any.

        The normal along a line is (cos phi cos, sin phi cos, -sin), perpendicular to the way from the apex to the
        viewer: rho cos(phi - phi_v) cos = z sin.
        """
        across, z = self.local_viewpoint(viewpoint)
        ratio = z * self.shape.slope / dr.norm(across)
        return dr.atan2(across.y, across.x), dr.safe_acos(ratio), dr.abs(ratio) < 1

    def turned_away(self, viewpoint: Point3f, uv: Point2f) -> tuple[Point2f, Bool]:
        middle, half, found = self._lines(viewpoint)
        side = dr.mulsign(Float(1), dr.sin(2 * math.pi * uv.x - middle))
        return Point2f(wrapped(middle + side * half), uv.y), found

    def drawn_along(self, viewpoint: Point3f, sample: Float) -> tuple[Point2f, Float, Bool]:
        middle, half, found = self._lines(viewpoint)
        second = sample >= 0.5
        angle = middle + dr.select(second, half, -half)
        v = 2 * sample - dr.select(second, Float(1), 0)
        shape = self.shape
        slant = shape.length * dr.sqrt(dr.fma(shape.slope, shape.slope, 1))
        return Point2f(wrapped(angle), v), dr.rcp(2 * slant), found

    def unit_gradient(self, p: Point3f) -> Vector3f:
        return Vector3f(p.x, p.y, -p.z)

    def local(self, uv: Point2f) -> Point3f:
        sin, cos = dr.sincos(2 * math.pi * uv.x)
        return Point3f(uv.y * cos, uv.y * sin, uv.y)


def wrapped(angle: Float) -> Float:
    """An angle as a fraction of a turn, from 0 to 1."""
    turn = angle * (0.5 / math.pi)
    return turn - dr.floor(turn)
