"""Warps: maps from uniform samples on [0, 1)^2 to other domains, and their densities.

Every `square_to_X` is area-preserving up to the density `square_to_X_pdf`; directions are
in local space with +z as the pole and their densities are per unit solid angle.
"""

from __future__ import annotations

import math

import drjit as dr

from djpt.types import Float, Point2f, Vector3f

__all__ = [
    "square_to_cosine_hemisphere",
    "square_to_cosine_hemisphere_pdf",
    "square_to_tent",
    "square_to_tent_pdf",
    "square_to_uniform_cone",
    "square_to_uniform_cone_pdf",
    "square_to_uniform_disk_concentric",
    "square_to_uniform_disk_concentric_pdf",
    "square_to_uniform_hemisphere",
    "square_to_uniform_hemisphere_pdf",
    "square_to_uniform_sphere",
    "square_to_uniform_sphere_pdf",
    "square_to_uniform_triangle",
    "square_to_uniform_triangle_pdf",
]

INV_PI = 1 / math.pi


def _sincos_quarter(phi: Float) -> tuple[Float, Float]:
    """The sine and cosine for abs(phi) <= pi/4, without the range reduction of `dr.sincos`.

    Taylor polynomials of degree 9 and 8: the truncation error is below 2e-7 there.
    """
    z = dr.square(phi)
    sin = dr.fma(dr.fma(dr.fma(dr.fma(z, 1 / 362880, -1 / 5040), z, 1 / 120), z, -1 / 6), z * phi, phi)
    cos = dr.fma(dr.fma(dr.fma(dr.fma(z, 1 / 40320, -1 / 720), z, 1 / 24), z, -0.5), z, 1)
    return sin, cos


def square_to_uniform_disk_concentric(sample: Point2f) -> Point2f:
    """Map the unit square to the unit disk, concentric squares to concentric circles.

    P. Shirley and K. Chiu, "A Low Distortion Map Between Disk and Square", JGT 2(3), 1997,
    in the form with one division and no branches published by D. Cline (2011).
    """
    x, y = dr.fma(2, sample.x, -1), dr.fma(2, sample.y, -1)
    swap = dr.abs(x) < dr.abs(y)
    r, other = dr.select(swap, y, x), dr.select(swap, x, y)
    phi = dr.select(r == 0, 0, (math.pi / 4) * other * dr.rcp(r))
    sin, cos = _sincos_quarter(phi)
    # In the swapped half the angle is pi/2 - phi, so sine and cosine change places.
    return Point2f(r * dr.select(swap, sin, cos), r * dr.select(swap, cos, sin))


def square_to_uniform_disk_concentric_pdf(p: Point2f) -> Float:
    """The density 1 / pi on the unit disk, per unit area."""
    return dr.select(dr.squared_norm(p) <= 1, Float(INV_PI), 0)


def square_to_cosine_hemisphere(sample: Point2f) -> Vector3f:
    """A cosine-weighted direction on the upper hemisphere: Malley's method over the concentric disk."""
    p = square_to_uniform_disk_concentric(sample)
    # By a rounding error the point may lie outside of the disk.
    z_squared = 1 - dr.squared_norm(p)
    return Vector3f(p.x, p.y, dr.sqrt(dr.select(z_squared > 0, z_squared, 0)))


def square_to_cosine_hemisphere_pdf(v: Vector3f) -> Float:
    """The density cos(theta) / pi on the upper hemisphere, else 0."""
    return dr.select(v.z > 0, v.z * INV_PI, 0)


def square_to_uniform_sphere(sample: Point2f) -> Vector3f:
    """A uniform direction on the sphere: z = 1 - 2 sample.y, phi = 2 pi sample.x."""
    z = dr.fma(-2, sample.y, 1)
    r = dr.safe_sqrt(dr.fma(-z, z, 1))
    sin, cos = dr.sincos(2 * math.pi * sample.x)
    return Vector3f(r * cos, r * sin, z)


def square_to_uniform_sphere_pdf(v: Vector3f) -> Float:
    """The density 1 / (4 pi) on the sphere."""
    return dr.full(Float, INV_PI / 4, dr.width(v))


def square_to_uniform_hemisphere(sample: Point2f) -> Vector3f:
    """A uniform direction on the upper hemisphere: z = 1 - r^2, r the radius of a point of the concentric disk.

    Equal areas of the disk lift to equal areas of the sphere (Archimedes).
    """
    p = square_to_uniform_disk_concentric(sample)
    r_squared = dr.squared_norm(p)
    scale = dr.sqrt(2 - r_squared)
    z = 1 - r_squared
    return Vector3f(p.x * scale, p.y * scale, dr.select(z > 0, z, 0))


def square_to_uniform_hemisphere_pdf(v: Vector3f) -> Float:
    """The density 1 / (2 pi) on the upper hemisphere, else 0."""
    return dr.select(v.z >= 0, Float(INV_PI / 2), 0)


def square_to_uniform_cone(sample: Point2f, cos_cutoff: Float) -> Vector3f:
    """A uniform direction in the cone around +z whose half-angle has the cosine `cos_cutoff`.

    Equal areas of the disk lift to equal areas of the cap (Archimedes).
    """
    p, height = square_to_uniform_disk_concentric(sample), 1 - cos_cutoff
    below = height * dr.squared_norm(p)
    scale = dr.safe_sqrt(height * (2 - below))
    z = 1 - below
    return Vector3f(p.x * scale, p.y * scale, dr.select(z > cos_cutoff, z, cos_cutoff))


def square_to_uniform_cone_pdf(v: Vector3f, cos_cutoff: Float) -> Float:
    """The density 1 / (2 pi (1 - cos_cutoff)) inside of the cone, else 0."""
    return dr.select(v.z >= cos_cutoff, dr.rcp(2 * math.pi * (1 - cos_cutoff)), 0)


def square_to_tent(sample: Point2f) -> Point2f:
    """A point on [-1, 1]^2 whose coordinates have the tent density 1 - abs(x): the weights of bilinear lookups."""
    return Point2f(_tent(sample.x), _tent(sample.y))


def _tent(sample: Float) -> Float:
    centred = sample - 0.5
    return dr.mulsign(1 - dr.safe_sqrt(dr.fma(dr.abs(centred), -2, 1)), centred)


def square_to_tent_pdf(p: Point2f) -> Float:
    """The density (1 - abs(x)) (1 - abs(y)) on [-1, 1]^2, per unit area."""
    x, y = 1 - dr.abs(p.x), 1 - dr.abs(p.y)
    return dr.select((x > 0) & (y > 0), x * y, 0)


def square_to_uniform_triangle(sample: Point2f) -> Point2f:
    """Uniform barycentric coordinates (b1, b2) of a triangle: b1 = 1 - sqrt(1 - x), b2 = y sqrt(1 - x)."""
    t = dr.safe_sqrt(1 - sample.x)
    return Point2f(1 - t, t * sample.y)


def square_to_uniform_triangle_pdf(b: Point2f) -> Float:
    """The density 2 on the triangle of barycentric coordinates, per unit of their area."""
    return dr.select((b.x >= 0) & (b.y >= 0) & (b.x + b.y <= 1), Float(2), 0)
