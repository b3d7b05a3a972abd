"""Warps of the unit square to the sphere, the hemisphere and cones; inverses, and densities per unit solid angle.

Directions are in local space with +z as the pole.
"""

from __future__ import annotations

import math

import drjit as dr

from djpt.core.warp.disk import square_to_uniform_disk_concentric, turns, uniform_disk_to_square_concentric
from djpt.jit.types import Float, Point2f, Vector3f, converting

__all__ = [
    "cosine_hemisphere_to_square",
    "square_to_cosine_hemisphere",
    "square_to_cosine_hemisphere_pdf",
    "square_to_uniform_cone",
    "square_to_uniform_cone_pdf",
    "square_to_uniform_hemisphere",
    "square_to_uniform_hemisphere_pdf",
    "square_to_uniform_sphere",
    "square_to_uniform_sphere_pdf",
    "uniform_cone_to_square",
    "uniform_hemisphere_to_square",
    "uniform_sphere_to_square",
]

INV_PI = 1 / math.pi


@converting
def square_to_cosine_hemisphere(sample: Point2f) -> Vector3f:
    """A cosine-weighted direction on the upper hemisphere: Malley's method over the concentric disk."""
    p = square_to_uniform_disk_concentric(sample)
    # By a rounding error the point may lie outside of the disk.
    z_squared = 1 - dr.squared_norm(p)
    return Vector3f(p.x, p.y, dr.sqrt(dr.select(z_squared > 0, z_squared, 0)))


@converting
def square_to_cosine_hemisphere_pdf(v: Vector3f) -> Float:
    """The density cos(theta) / pi on the upper hemisphere, else 0."""
    return dr.select(v.z > 0, v.z * INV_PI, 0)


@converting
def square_to_uniform_sphere(sample: Point2f) -> Vector3f:
    """A uniform direction on the sphere: z = 1 - 2 sample.y, phi = 2 pi sample.x."""
    z = dr.fma(-2, sample.y, 1)
    r = dr.safe_sqrt(dr.fma(-z, z, 1))
    sin, cos = dr.sincos(2 * math.pi * sample.x)
    return Vector3f(r * cos, r * sin, z)


@converting
def square_to_uniform_sphere_pdf(v: Vector3f) -> Float:
    """The density 1 / (4 pi) on the sphere."""
    return dr.full(Float, INV_PI / 4, dr.width(v))


@converting
def square_to_uniform_hemisphere(sample: Point2f) -> Vector3f:
    """A uniform direction on the upper hemisphere: z = 1 - r^2, r the radius of a point of the concentric disk.

    Equal areas of the disk lift to equal areas of the sphere (Archimedes).
    """
    p = square_to_uniform_disk_concentric(sample)
    r_squared = dr.squared_norm(p)
    scale = dr.sqrt(2 - r_squared)
    z = 1 - r_squared
    return Vector3f(p.x * scale, p.y * scale, dr.select(z > 0, z, 0))


@converting
def square_to_uniform_hemisphere_pdf(v: Vector3f) -> Float:
    """The density 1 / (2 pi) on the upper hemisphere, else 0."""
    return dr.select(v.z >= 0, Float(INV_PI / 2), 0)


@converting
def square_to_uniform_cone(v: Point2f, cos_cutoff: Float) -> Vector3f:
    """A uniform direction in the cone around +z whose half-angle has the cosine `cos_cutoff`.

    Equal areas of the disk lift to equal areas of the cap (Archimedes).
    """
    p, height = square_to_uniform_disk_concentric(v), 1 - cos_cutoff
    below = height * dr.squared_norm(p)
    scale = dr.safe_sqrt(height * (2 - below))
    z = 1 - below
    return Vector3f(p.x * scale, p.y * scale, dr.select(z > cos_cutoff, z, cos_cutoff))


@converting
def square_to_uniform_cone_pdf(v: Vector3f, cos_cutoff: Float) -> Float:
    """The density 1 / (2 pi (1 - cos_cutoff)) inside of the cone, else 0."""
    return dr.select(v.z >= cos_cutoff, dr.rcp(2 * math.pi * (1 - cos_cutoff)), 0)


@converting
def uniform_sphere_to_square(sample: Vector3f) -> Point2f:
    """The inverse of `square_to_uniform_sphere`."""
    return Point2f(turns(sample.y, sample.x), 0.5 * (1 - sample.z))


@converting
def uniform_hemisphere_to_square(v: Vector3f) -> Point2f:
    """The inverse of `square_to_uniform_hemisphere`."""
    scale = dr.rsqrt(v.z + 1)
    return uniform_disk_to_square_concentric(Point2f(v.x * scale, v.y * scale))


@converting
def cosine_hemisphere_to_square(v: Vector3f) -> Point2f:
    """The inverse of `square_to_cosine_hemisphere`."""
    return uniform_disk_to_square_concentric(Point2f(v.x, v.y))


@converting
def uniform_cone_to_square(v: Vector3f, cos_cutoff: Float) -> Point2f:
    """The inverse of `square_to_uniform_cone`."""
    p = Point2f(v.x, v.y)
    squared = dr.squared_norm(p)
    scale = dr.select(squared > 0, dr.sqrt((1 - v.z) / (squared * (1 - cos_cutoff))), 0)
    return uniform_disk_to_square_concentric(p * scale)
