"""The ray-triangle test that all accelerators share.

Corners are projected along the ray, onto a plane across it; the ray then is the origin, and it hits
where the three edge functions agree in sign. Triangles that share an edge compute its function from
the same projected corners, and with the same rounding up to the sign, so that no ray slips through
between them: the test is watertight. It costs a few operations more than Moeller and Trumbore's.

S. Woop, C. Benthin and I. Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013; with a
plane across the ray instead of a permutation of axes, which suits SIMD lanes.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from djpt.jit.kernels import maximum, minimum
from djpt.jit.types import Bool, Float, Point3f, Vector3f

__all__ = ["RayPlane", "TriangleHit", "intersect_triangle"]


@dataclass
class TriangleHit:
    """The result of a ray-triangle test; where `hit` is false, the other fields are unspecified."""

    hit: Bool
    t: Float
    """Distance in units of the ray's `d`, along the whole line: it may be negative or beyond `maxt`."""
    b1: Float
    """Barycentric weight of the second corner."""
    b2: Float
    """Barycentric weight of the third corner."""


class RayPlane:
    """A ray and two directions across it. Neither they nor `d` need have unit length."""

    def __init__(self, o: Point3f, d: Vector3f) -> None:
        # Perpendicular to d by swapping two components that aren't both small.
        steep = dr.abs(d.x) > dr.abs(d.z)
        s = Vector3f(dr.select(steep, -d.y, 0), dr.select(steep, d.x, -d.z), dr.select(steep, 0, d.y))
        self._axes = [(axis, -dr.dot(axis, o)) for axis in (s, dr.cross(d, s), d)]
        self.inv_length_squared = dr.rcp(dr.squared_norm(d))

    def project(self, p: Point3f) -> list[Float]:
        """Coordinates of a point across the ray (two) and along it, seen from the origin.

        The rounding error is relative to the coordinates, so the triangles should lie near the origin of coordinates.
        """
        return [dr.fma(a.x, p.x, dr.fma(a.y, p.y, dr.fma(a.z, p.z, offset))) for a, offset in self._axes]


def intersect_triangle(ray: RayPlane, p0: Point3f, p1: Point3f, p2: Point3f) -> TriangleHit:
    """Intersect a line with a triangle, edges included; the caller compares `t`.

    `t` is a convex combination of the corners' distances, so that even a sliver seen edge-on doesn't
    give one far off. It is NaN or infinite for triangles that the ray sees exactly edge-on.
    """
    (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = ray.project(p0), ray.project(p1), ray.project(p2)
    # Products and differences are rounded one by one (Dr.Jit doesn't fuse them): swapping the ends of an
    # edge then changes the sign of its function and nothing else.
    w0 = x2 * y1 - y2 * x1
    w1 = x0 * y2 - y0 * x2
    w2 = x1 * y0 - y1 * x0
    inv = dr.rcp(w0 + w1 + w2)
    inside = (minimum(minimum(w0, w1), w2) >= 0) | (maximum(maximum(w0, w1), w2) <= 0)
    t = dr.fma(w0, z0, dr.fma(w1, z1, w2 * z2)) * inv * ray.inv_length_squared
    return TriangleHit(inside, t, w1 * inv, w2 * inv)
