"""The way of a ray from far away to a tree, without loss."""

from __future__ import annotations

from typing import Protocol

import drjit as dr

from djpt.core.records import Ray3f
from djpt.jit.types import Float, Point3f

__all__ = ["enter"]


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
