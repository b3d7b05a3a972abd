"""Directions and their spherical coordinates."""

from __future__ import annotations

import drjit as dr

from djpt.jit.types import Float, Point2f, Vector3f, converting

__all__ = ["dir_to_sph", "sph_to_dir"]


@converting
def sph_to_dir(theta: Float, phi: Float) -> Vector3f:
    """The direction at the angle `theta` from +z, turned by `phi` from +x to +y."""
    sin_theta, cos_theta = dr.sincos(theta)
    sin_phi, cos_phi = dr.sincos(phi)
    return Vector3f(cos_phi * sin_theta, sin_phi * sin_theta, cos_theta)


@converting
def dir_to_sph(v: Vector3f) -> Point2f:
    """The angles (theta, phi) of a direction of unit length, theta in [0, pi] and phi in (-pi, pi].

    The polar angle is twice an arc sine of half of the distance to the nearer pole, which is exact near the poles, too.
    """
    lower = v.z < 0
    pole = dr.select(lower, Float(-1), 1)
    half = dr.safe_asin(0.5 * dr.norm(Vector3f(v.x, v.y, v.z - pole)))
    return Point2f(dr.select(lower, dr.pi - 2 * half, 2 * half), dr.atan2(v.y, v.x))
