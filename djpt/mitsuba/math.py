"""Mathematical functions under the name that Mitsuba scripts use."""

from __future__ import annotations

from djpt.mitsuba.mathematics import (
    RayEpsilon,
    ShadowEpsilon,
    ShapeEpsilon,
    chi2,
    find_interval,
    is_power_of_two,
    legendre_p,
    legendre_pd,
    legendre_pd_diff,
    linear_to_srgb,
    morton_decode2,
    morton_decode3,
    morton_encode2,
    morton_encode3,
    round_to_power_of_two,
    solve_quadratic,
    srgb_to_linear,
    ulpdiff,
)

__all__ = [
    "RayEpsilon",
    "ShadowEpsilon",
    "ShapeEpsilon",
    "chi2",
    "find_interval",
    "is_power_of_two",
    "legendre_p",
    "legendre_pd",
    "legendre_pd_diff",
    "linear_to_srgb",
    "morton_decode2",
    "morton_decode3",
    "morton_encode2",
    "morton_encode3",
    "round_to_power_of_two",
    "solve_quadratic",
    "srgb_to_linear",
    "ulpdiff",
]
