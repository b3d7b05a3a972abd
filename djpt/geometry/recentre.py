"""Rays from far away, started again near the shapes: those that are unrolled, and those in trees."""

from __future__ import annotations

from typing import Protocol

import drjit as dr

from djpt.core.records import Ray3f
from djpt.jit.types import Float, Point3f

__all__ = ["enter", "recentre"]


def recentre(ray: Ray3f, low: Point3f, high: Point3f) -> tuple[Ray3f, Float]:
    """Start a ray where it comes near the box from `low` to `high`; return it and the distance, in units of `d`.

    Intersections subtract coordinates of the origin: from 10^4 sizes away 4 of 7 digits are lost, and rays miss what
    they should hit. A ray that starts outside of the sphere around the box begins at that sphere instead (or beside it,
    at the point closest to its centre, if it passes by); all others stay as they are. The new origin is o + t0 d
    rounded once, whatever t0 is, so nothing is lost on the way. Distances count from there: t = t0 + t'. `maxt`
    becomes maxt - t0. An infinite or empty box changes nothing.
    """
    to_center = 0.5 * (low + high) - ray.o
    radius = 0.5 * dr.norm(high - low)
    inv = dr.rsqrt(dr.squared_norm(ray.d))
    t0 = (dr.dot(to_center, ray.d) * inv - radius) * inv
    t0 = dr.select((t0 > 0) & (t0 < ray.maxt) & dr.isfinite(t0), t0, 0)
    return ray.replaced(o=dr.fma(ray.d, t0, ray.o), maxt=ray.maxt - t0), t0


# ---- trees -------------------------------------------------------------------------------------------------------


class Sphere(Protocol):
    """A sphere that holds everything."""

    center: Point3f
    radius: Float


def enter(tree: Sphere, ray: Ray3f) -> tuple[Point3f, Float]:
    """Move a ray's origin near the triangles: the new origin, relative to the tree's centre, and the distance moved.

    A ray that starts within the sphere about all triangles keeps its origin. Other origins are moved without
    loss: the errors of all sums and products are carried along, so that from far away triangles are hit
    as precisely as from nearby (T. Ogita, S. Rump and S. Oishi, "Accurate Sum and Dot Product", 2005).
    """
    from_center, lost = two_sum(ray.o, -tree.center)
    inv = dr.rsqrt(dr.squared_norm(ray.d))
    t = -dr.dot(from_center, ray.d) * dr.square(inv) - tree.radius * inv
    t = dr.select(t > 0, t, 0)
    step = ray.d * t
    moved, also_lost = two_sum(from_center, step)
    return moved + (lost + also_lost + dr.fma(ray.d, t, -step)), t


def two_sum(a: Point3f, b: Point3f) -> tuple[Point3f, Point3f]:
    """The rounded sum, and its rounding error (D. Knuth, TAOCP vol. 2, 4.2.2)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)
