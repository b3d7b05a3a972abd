"""Directions as points of the square [-1, 1]^2, without an angle.

A direction is projected from the centre to the octahedron |x| + |y| + |z| = 1, whose upper half is the inner diamond of
the square, |u| + |v| <= 1; the lower half is folded outwards. A piece du dv of the square covers the solid angle
s^3 du dv, with s = |x| + |y| + |z| of the unit vector, between 1 and 3 sqrt(3).

E. Praun and H. Hoppe, "Spherical Parametrization and Remeshing", SIGGRAPH 2003.
"""

from __future__ import annotations

import drjit as dr

from djpt.jit.kernels import maximum
from djpt.jit.types import Float, Point2f, Vector3f

__all__ = ["direction_at", "place_of"]


def direction_at(place: Point2f) -> Vector3f:
    """The unit vector at a point of the square."""
    z = 1 - dr.abs(place.x) - dr.abs(place.y)
    below = maximum(-z, 0.0)
    return dr.normalize(Vector3f(place.x - dr.mulsign(below, place.x), place.y - dr.mulsign(below, place.y), z))


def place_of(d: Vector3f) -> tuple[Point2f, Float]:
    """The point of a unit vector, and the solid angle per area of the square there."""
    s = dr.abs(d.x) + dr.abs(d.y) + dr.abs(d.z)
    inverse = dr.rcp(s)
    x, y = d.x * inverse, d.y * inverse
    folded = Point2f(dr.mulsign(1 - dr.abs(y), x), dr.mulsign(1 - dr.abs(x), y))
    return dr.select(d.z < 0, folded, Point2f(x, y)), s * s * s
