"""Special functions, integers, searches and encodings: the names of `djpt.math` and `djpt.math_py`."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.forms import forms
from djpt.core.srgb import linear_to_srgb, srgb_to_linear
from djpt.distributions.search import find_interval
from djpt.errors import BackendError
from djpt.jit.kernels import power_of_two
from djpt.jit.types import Bool, Float, Point2f, UInt32, Vector3f, backend, converting

__all__ = [
    "RayEpsilon",
    "ShadowEpsilon",
    "ShapeEpsilon",
    "chi2",
    "dir_to_sph",
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
    "rlgamma",
    "round_to_power_of_two",
    "solve_quadratic",
    "sph_to_dir",
    "srgb_to_linear",
    "ulpdiff",
]

Array2u, Array3u = backend.Array2u, backend.Array3u

RayEpsilon = 1500 * 2.0**-24
"""Distance, relative to the size of coordinates, that Mitsuba's rays start from surfaces."""
ShadowEpsilon = 10 * RayEpsilon
"""The same for the end of shadow rays."""
ShapeEpsilon = RayEpsilon / 80
"""The same for intersections with shapes."""


# ---- Legendre polynomials --------------------------------------------------------------------


@forms("l x", "l m x")
def legendre_p(*, l: int, m: int | None = None, x: Any) -> Float:  # noqa: E741
    """Legendre's polynomial P_l(x), or the associated function P_l^m(x) with the phase (-1)^m.

    By Bonnet's recurrence, (n + 1 - m) P_(n+1) = (2 n + 1) x P_n - (n + m) P_(n-1) (M. Abramowitz and I. A. Stegun,
    "Handbook of Mathematical Functions", 8.5.3).
    """
    x, order = Float(x), m or 0
    last, current = Float(0), dr.zeros(Float, dr.width(x)) + 1
    root = dr.sqrt((1 - x) * (1 + x))
    for k in range(order):
        current = current * -(2 * k + 1) * root
    for n in range(order, l):
        last, current = current, ((2 * n + 1) * x * current - (n + order) * last) / (n + 1 - order)
    return current


@converting
def legendre_pd(l: int, x: Float) -> tuple[Float, Float]:  # noqa: E741
    """Legendre's polynomial P_l(x) and its derivative, by P'_(n+1) = P'_(n-1) + (2 n + 1) P_n."""
    _, last = legendre_steps(l, x)
    return last


@converting
def legendre_pd_diff(l: int, x: Float) -> tuple[Float, Float]:  # noqa: E741
    """The difference P_(l+1)(x) - P_(l-1)(x), and its derivative; its roots are those of (1 - x^2) P'_l(x)."""
    (p0, d0), (p2, d2) = (legendre_steps(degree, x)[1] for degree in (l - 1, l + 1))
    return p2 - p0, d2 - d0


def legendre_steps(l: int, x: Any) -> tuple[tuple[Any, Any], tuple[Any, Any]]:  # noqa: E741
    """The pairs (P, P') of degrees l - 1 and l."""
    zero = x * 0
    last, current = (zero, zero), (zero + 1, zero)
    for n in range(l):
        value = ((2 * n + 1) * x * current[0] - n * last[0]) / (n + 1)
        last, current = current, (value, last[1] + (2 * n + 1) * current[0])
    return last, current


# ---- equations and searches ------------------------------------------------------------------


@converting
def solve_quadratic(a: Float, b: Float, c: Float) -> tuple[Bool, Float, Float]:
    """Solve a x^2 + b x + c = 0.

    Neither root is a difference of numbers that are nearly equal ("Numerical Recipes", 3rd ed., section 5.6).

    Returns:
        Whether there are solutions, and these in order; if `a` is 0, the same one twice. Otherwise they mean nothing.
    """
    linear = a == 0
    discriminant = dr.fma(b, b, -4 * a * c)
    root: Any = dr.copysign(dr.sqrt(discriminant), b)
    q = -0.5 * (b + root)
    x0, x1 = q / a, c / q
    found = dr.select(linear, b != 0, discriminant >= 0)
    single = -c / b
    return (
        found,
        dr.select(linear, single, dr.minimum(x0, x1)),
        dr.select(linear, single, dr.maximum(x0, x1)),
    )


# ---- integers --------------------------------------------------------------------------------


def is_power_of_two(arg: int, /) -> bool:
    """Whether an integer is 1, 2, 4, 8 ..."""
    return arg > 0 and arg & (arg - 1) == 0


def round_to_power_of_two(arg: int, /) -> int:
    """The smallest power of two that isn't smaller."""
    return power_of_two(arg)


def ulpdiff(arg0: float, arg1: float, /) -> float:
    """The difference of a single precision number from a reference, the first one, in units of its last place.

    Units are those of Mitsuba, half as large as the distance of neighbouring numbers.
    """
    reference, value = float(np.float32(arg0)), float(np.float32(arg1))
    _, exponent = math.frexp(reference)
    return abs(reference - value) / 2.0 ** (exponent - 25)


# ---- Morton codes ----------------------------------------------------------------------------


def morton_encode2(v: Any) -> UInt32:
    """The bits of two 16-bit integers, interleaved: those of the first one are at even places."""
    v = Array2u(v)
    return spread(v.x, 2) | (spread(v.y, 2) << 1)


def morton_encode3(v: Any) -> UInt32:
    """The bits of three 10-bit integers, interleaved."""
    v = Array3u(v)
    return spread(v.x, 3) | (spread(v.y, 3) << 1) | (spread(v.z, 3) << 2)


@converting
def morton_decode2(m: UInt32) -> Any:
    """The inverse of `morton_encode2`."""
    return Array2u(*(gathered(m >> k, 2) for k in range(2)))


@converting
def morton_decode3(m: UInt32) -> Any:
    """The inverse of `morton_encode3`."""
    return Array3u(*(gathered(m >> k, 3) for k in range(3)))


MASKS = {
    2: ((16, 0x0000FFFF), (8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)),
    3: ((32, 0x000003FF), (16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)),
}
"""How bits are spread with gaps of one or two bits: by halves of groups, (distance, places of the bits)."""


def spread(x: UInt32, gap: int) -> UInt32:
    """The bits of an integer, `gap` places apart."""
    (_, mask), *steps = MASKS[gap]
    x = x & mask
    for distance, places in steps:
        x = (x | (x << distance)) & places
    return x


def gathered(x: UInt32, gap: int) -> UInt32:
    """The inverse of `spread`; the bits between are ignored."""
    (_, first), *steps = MASKS[gap]
    x = x & steps[-1][1]
    for (distance, _), (_, places) in zip(reversed(steps), reversed([(0, first), *steps[:-1]]), strict=True):
        x = (x | (x >> distance)) & places
    return x


# ---- statistics of tests ---------------------------------------------------------------------


def chi2(obs: Any, exp: Any, pool_threshold: float, slack: Any = 0.0) -> tuple[float, int, int, int]:
    """Pearson's statistic, the sum of (observed - expected)^2 / expected.

    Args:
        obs: observed counts.
        exp: expected ones.
        pool_threshold: cells with smaller expectations are pooled in order until their sum exceeds it.
        slack: what is added to the divisor, for all cells or for each: the squared error of expectations that are
            known roughly. Mitsuba's function has no such argument.

    Returns:
        The statistic; the degrees of freedom; how many cells were pooled; into how many.
    """
    observed, expected = (np.array(values, np.float64).ravel() for values in (obs, exp))
    extra = np.broadcast_to(np.asarray(slack, np.float64), expected.shape)
    common = expected >= pool_threshold
    statistic = float(((observed - expected)[common] ** 2 / (expected + extra)[common]).sum())
    rare = ~common & ((observed != 0) | (expected != 0))
    pooled, sums = 0, np.zeros(3)
    for triple in zip(observed[rare], expected[rare], extra[rare], strict=True):
        sums += triple
        if sums[1] > pool_threshold:
            statistic += float((sums[0] - sums[1]) ** 2 / (sums[1] + sums[2]))
            sums[:] = 0
            pooled += 1
    return statistic, int(common.sum()) + pooled - 1, int(rare.sum()), pooled


def rlgamma(a: float, x: float) -> float:
    """The regularised lower incomplete gamma function P(a, x), for a > 0 and x >= 0, by SciPy.

    With a = n / 2 and x = s / 2 it is the chance that Pearson's statistic with n degrees of freedom is at most s.

    Raises:
        BackendError: SciPy isn't installed.
    """
    if a < 0 or x < 0:
        raise ValueError(f"rlgamma(): 'a' and 'x' must not be negative, found {a} and {x}")
    try:
        from scipy.special import gammainc
    except ImportError:
        raise BackendError("the chi-squared test needs SciPy: pip install scipy") from None
    return float(gammainc(a, x))


# ---- directions and their spherical coordinates ----------------------------------------------


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
