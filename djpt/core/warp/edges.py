"""Warps to directions at edges of surfaces: tangents of one face, and the lunes between the planes of two."""

from __future__ import annotations

import math

import drjit as dr

from djpt.core.frame import coordinate_system
from djpt.core.warp.disk import turns
from djpt.jit.types import Float, Normal3f, Point2f, Vector3f, converting

__all__ = [
    "interval_to_tangent_direction",
    "square_to_uniform_spherical_lune",
    "square_to_uniform_spherical_lune_pdf",
    "tangent_direction_to_interval",
    "uniform_spherical_lune_to_square",
]


@converting
def interval_to_tangent_direction(n: Normal3f, sample: Float) -> Vector3f:
    """A uniform direction of the plane with the unit normal `n`."""
    s, t = coordinate_system(n)
    sin, cos = dr.sincos(2 * math.pi * sample)
    return dr.fma(s, cos, t * sin)


@converting
def tangent_direction_to_interval(n: Normal3f, dir: Vector3f) -> Float:
    """The inverse of `interval_to_tangent_direction`."""
    s, t = coordinate_system(n)
    return turns(dr.dot(dir, t), dr.dot(dir, s))


@converting
def square_to_uniform_spherical_lune(sample: Point2f, n1: Normal3f, n2: Normal3f) -> Vector3f:
    """A uniform direction along which exactly one of two adjacent faces is seen from its front.

    These directions are the two lunes between the planes with the normals `n1` and `n2`. Half of the samples go to
    either lune; the height along the edge is uniform, as on the whole sphere (Archimedes).
    """
    x, y, z, half = _lune(n1, n2)
    height = dr.fma(-2, sample.y, 1)
    r = dr.safe_sqrt(dr.fma(-height, height, 1))
    first = sample.x < 0.5
    angle = half * dr.select(first, 4 * sample.x - 1, 4 * sample.x - 3) + dr.select(first, 0, math.pi)
    sin, cos = dr.sincos(angle)
    return x * (r * cos) + y * (r * sin) + z * height


@converting
def uniform_spherical_lune_to_square(d: Vector3f, n1: Normal3f, n2: Normal3f) -> Point2f:
    """The inverse of `square_to_uniform_spherical_lune`; directions just outside of a lune count to its border."""
    x, y, z, half = _lune(n1, n2)
    along = dr.dot(d, x)
    first = along >= 0
    # Both lunes are measured from their own middle: the second one is the first one, turned by pi.
    angle = dr.clip(dr.atan2(dr.mulsign(dr.dot(d, y), along), dr.abs(along)), -half, half)
    return Point2f(dr.fma(0.25, angle / half, dr.select(first, 0.25, 0.75)), 0.5 * (1 - dr.dot(d, z)))


@converting
def square_to_uniform_spherical_lune_pdf(d: Vector3f, n1: Normal3f, n2: Normal3f) -> Float:
    """The density 1 / (8 half) in the lunes, with `half` half of the angle between the normals, else 0."""
    half = 0.5 * dr.acos(dr.dot(n1, n2))
    return dr.select(dr.dot(d, n1) * dr.dot(d, n2) <= 0, dr.rcp(8 * half), 0)


def _lune(n1: Normal3f, n2: Normal3f) -> tuple[Vector3f, Vector3f, Vector3f, Float]:
    """A frame (middle of the first lune, mean of the normals, edge), and half of the angle of a lune."""
    z = dr.normalize(dr.cross(n1, n2))
    y = dr.normalize(n1 + n2)
    return dr.cross(z, y), y, z, 0.5 * dr.acos(dr.dot(n1, n2))
