"""Rays and spheres that are much larger than what stands on them.

Coordinates relative to the centre of a sphere of radius R have errors of R 2^-24, which may be more than a ray's offset
from the surface. But the surface may pass near the origin, where coordinates are small. So the sphere is written as

    Q(p) = |p|^2 - 2 p.c + k = 0,    k = |c|^2 - R^2    from double precision,

whose value at a point at height h is 2 R h, with an error of about R |p| 2^-22: that of h is one of |p|, not of R.
"""

from __future__ import annotations

import math

import drjit as dr

from djpt.core.records import RAY_EPSILON, Ray3f
from djpt.jit.types import Bool, Float, Point3f

__all__ = ["intersect_large", "is_large"]

ROUNDING = 2.0**-21
"""The error of a hit that is computed relative to the centre, per unit of the coordinates."""


def is_large(distance: float, radius: float) -> bool:
    """Whether hits computed relative to the centre, at a `distance` from the origin, are too rough near the origin.

    That is so if their error may exceed a spawned ray's offset where the surface is nearest to the origin.
    """
    return ROUNDING * (distance + radius) > RAY_EPSILON * (1 + abs(distance - radius))


def intersect_large(ray: Ray3f, center: Point3f, radius: Float, power: Float) -> tuple[Bool, Float]:
    """Whether a ray hits a sphere at some t > 0, and the first such t; `power` is k, that of the origin."""
    d = ray.d
    inv = dr.rcp(dr.squared_norm(d))
    # Rays from far away begin at two radii from the point closest to the centre.
    closest = (dr.dot(center, d) - dr.dot(ray.o, d)) * inv
    start = dr.maximum(closest - 2 * radius * dr.sqrt(inv), 0)
    o = dr.fma(d, start, ray.o)
    slope = dr.dot(o, d) - dr.dot(center, d)
    value = dr.dot(o, o - 2 * center) + power
    discriminant = dr.fma(slope, slope, -dr.squared_norm(d) * value)
    # One solution is a sum of equal signs, the other their product divided by it: nothing cancels.
    both = -(slope + dr.mulsign(dr.sqrt(discriminant), slope))
    first, second = value * dr.rcp(both), both * inv
    near, far = dr.minimum(first, second), dr.maximum(first, second)
    t = start + dr.select(near > 0, near, far)
    return (discriminant >= 0) & (t > start) & (t < math.inf), t
