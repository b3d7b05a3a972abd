"""The weights of samples that the integrators for moving shapes share."""

from __future__ import annotations

import drjit as dr

from djpt.integrators.base import mis_weight as power_heuristic
from djpt.jit.types import Bool, Float, Normal3f, Point3f, converting

__all__ = ["mis_weight", "solid_angle_to_area_jacobian"]


@converting
def mis_weight(pdf_a: Float, pdf_b: Float) -> Float:
    """The weight a^2 / (a^2 + b^2) of a sample of the density `pdf_a`, detached; 0 if both densities are 0."""
    return dr.detach(power_heuristic(pdf_a, pdf_b))


@converting
def solid_angle_to_area_jacobian(o: Point3f, p: Point3f, n: Normal3f, active: Bool | bool = True) -> Float:
    """The solid angle at `o` per area at the surface point `p` with the normal `n`: abs(cos) / dist^2.

    1 on inactive lanes.
    """
    d = p - o
    squared = dr.squared_norm(d)
    return dr.select(active, dr.abs(dr.dot(n, d)) * dr.rsqrt(squared) / squared, 1)
