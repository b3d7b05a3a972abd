"""Cubic B-splines in kernels: places along a curve, and the axes across it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.jit.types import Array4f, Float, Point3f, Vector3f

__all__ = ["Place", "cubic_place", "local_axes", "unit", "vector"]


@dataclass
class Place:
    """A place along a curve: the centre, the radius, and derivatives with respect to the parameter of the segment."""

    c: Point3f
    dc: Vector3f
    ddc: Vector3f
    r: Float
    dr: Float
    ddr: Float


def cubic_place(points: Sequence[Array4f], v: Float) -> Place:
    """A place on a segment of a uniform cubic B-spline."""
    w = 1 - v
    basis = w * w * w, v * v * (3 * v - 6) + 4, v * (3 + v * (3 - 3 * v)) + 1, v * v * v
    first = -w * w, v * (3 * v - 4), 1 + v * (2 - 3 * v), v * v
    second = w, 3 * v - 2, 1 - 3 * v, v
    at, change, bend = (
        sum(
            (point * (weight * scale) for point, weight in zip(points[1:], weights[1:], strict=True)),
            points[0] * (weights[0] * scale),
        )
        for weights, scale in ((basis, 1 / 6), (first, 0.5), (second, 1.0))
    )
    return Place(vector(at), vector(change), vector(bend), at.w, change.w, bend.w)


def unit(v: Any) -> Any:
    """A vector of length 1; 0 if it has no length."""
    return v * dr.rsqrt(dr.maximum(dr.squared_norm(v), 1e-30))


def vector(a: Array4f) -> Vector3f:
    """The first three components."""
    return Vector3f(a.x, a.y, a.z)


def local_axes(tangent: Vector3f, place: Place) -> tuple[Vector3f, Vector3f, Float]:
    """Two axes across a curve that angles are counted by, and how fast they turn about the tangent along it.

    The first is the z axis of the world, made perpendicular to the tangent; angles begin at the second.
    """
    z = tangent.z
    upright = dr.abs(z) >= 1
    across = Vector3f(-tangent.x * z, -tangent.y * z, 1 - z * z)
    inv = dr.rsqrt(dr.maximum(dr.squared_norm(across), 1e-30))
    rotation = dr.select(upright, Vector3f(0, 1, 0), across * inv)
    origin = dr.cross(rotation, tangent)
    speed = dr.rsqrt(dr.maximum(dr.squared_norm(place.dc), 1e-30))
    turn = (place.ddc - tangent * dr.dot(tangent, place.ddc)) * speed
    return rotation, origin, dr.select(upright, 0, dr.dot(turn, origin) * z * inv)
