"""Warps of the unit square to lobes of directions about +z, inverses, and densities per unit solid angle."""

from __future__ import annotations

import math

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.warp.disk import square_to_uniform_disk_concentric, turns, uniform_disk_to_square_concentric
from djpt.core.warp.sphere import square_to_uniform_sphere
from djpt.jit.types import Float, Point2f, Point3f, Vector3f, converting

__all__ = [
    "beckmann_to_square",
    "square_to_beckmann",
    "square_to_beckmann_pdf",
    "square_to_rough_fiber",
    "square_to_rough_fiber_pdf",
    "square_to_von_mises_fisher",
    "square_to_von_mises_fisher_pdf",
    "von_mises_fisher_to_square",
]


@converting
def square_to_beckmann(sample: Point2f, alpha: Float) -> Vector3f:
    """A normal of a rough surface by Beckmann's density, about +z: the slopes are Gaussian.

    The tangent of the angle to +z is alpha sqrt(-log(1 - r^2)), r the radius of a point of the concentric disk.
    """
    p = square_to_uniform_disk_concentric(sample)
    r2 = dr.squared_norm(p)
    # By a rounding error the point may lie on the edge of the disk, or outside.
    tan2 = -dr.square(alpha) * dr.log(dr.maximum(1 - r2, 2.0**-24))
    cos = dr.rsqrt(1 + tan2)
    scale = dr.select(r2 > 0, dr.safe_sqrt(dr.fma(-cos, cos, 1) / r2), 0)
    return Vector3f(p.x * scale, p.y * scale, cos)


@converting
def beckmann_to_square(v: Vector3f, alpha: Float) -> Point2f:
    """The inverse of `square_to_beckmann`."""
    cos2 = dr.square(v.z)
    r2 = 1 - dr.exp((1 - dr.rcp(cos2)) / dr.square(alpha))
    scale = dr.select(cos2 < 1, dr.safe_sqrt(r2 / (1 - cos2)), 0)
    return uniform_disk_to_square_concentric(Point2f(v.x * scale, v.y * scale))


@converting
def square_to_beckmann_pdf(v: Vector3f, alpha: Float) -> Float:
    """The density exp(-tan^2 / alpha^2) / (pi alpha^2 cos^3), 0 below the horizon."""
    cos2 = dr.square(v.z)
    tan2 = (1 - cos2) / cos2
    density = dr.exp(-tan2 / dr.square(alpha)) / (math.pi * dr.square(alpha) * cos2 * v.z)
    return dr.select(v.z < 1e-9, 0, density)


@converting
def square_to_von_mises_fisher(sample: Point2f, kappa: Float) -> Vector3f:
    """A direction with a density proportional to exp(kappa cos theta).

    W. Jakob, "Numerically stable sampling of the von Mises Fisher distribution on S2 (and other tricks)", 2012.
    """
    u = dr.maximum(1 - sample.y, 1e-6)
    cos = 1 + dr.log(dr.fma(1 - u, dr.exp(-2 * kappa), u)) / kappa
    r = dr.safe_sqrt(1 - dr.square(cos))
    s, c = dr.sincos(2 * math.pi * sample.x)
    return dr.select(kappa == 0, square_to_uniform_sphere(sample), Vector3f(c * r, s * r, cos))


@converting
def von_mises_fisher_to_square(v: Vector3f, kappa: Float) -> Point2f:
    """The inverse of `square_to_von_mises_fisher`, for kappa > 0."""
    y = (1 - dr.exp((v.z - 1) * kappa)) / (1 - dr.exp(-2 * kappa))
    return Point2f(turns(v.y, v.x), y)


@converting
def square_to_von_mises_fisher_pdf(v: Vector3f, kappa: Float) -> Float:
    """The density kappa exp(kappa (cos theta - 1)) / (2 pi (1 - exp(-2 kappa)))."""
    density = dr.exp(kappa * (v.z - 1)) * (kappa * (0.5 / math.pi)) / (1 - dr.exp(-2 * kappa))
    return dr.select(kappa > 0, density, 0.25 / math.pi)


@converting
def square_to_rough_fiber(sample: Point3f, wi: Vector3f, tangent: Vector3f, kappa: Float) -> Vector3f:
    """A direction scattered by a rough fibre: one of the cone of mirror directions, perturbed by a lobe around it.

    The lobe is `square_to_von_mises_fisher`.

    Args:
        sample: the angle on the cone, and the two numbers of the perturbation.
        wi: where the light comes from.
        tangent: of the fibre, of unit length.
        kappa: the concentration of the perturbation.
    """
    along = Frame3f.from_normal(tangent)
    local = along.to_local(wi)
    sin, cos = dr.sincos(2 * math.pi * sample.x)
    r = dr.safe_sqrt(dr.fma(-local.z, local.z, 1))
    mirrored = Frame3f.from_normal(Vector3f(cos * r, sin * r, -local.z))
    return along.to_world(mirrored.to_world(square_to_von_mises_fisher(Point2f(sample.y, sample.z), kappa)))


@converting
def square_to_rough_fiber_pdf(v: Vector3f, wi: Vector3f, tangent: Vector3f, kappa: Float) -> Float:
    """The density of `square_to_rough_fiber`: the von Mises Fisher lobe averaged over the cone.

    kappa / (4 pi sinh kappa) exp(-s) I0(c), with s and c the products of kappa and the sines, and cosines, that both
    directions have with the plane across the fibre (E. d'Eon, S. Marschner and J. Hanika, "Importance Sampling for
    Physically-Based Hair Fiber Models", SIGGRAPH Asia 2013 Technical Briefs).
    """
    sin_i, sin_o = dr.dot(wi, tangent), dr.dot(v, tangent)
    c = dr.safe_sqrt(dr.fma(-sin_i, sin_i, 1)) * dr.safe_sqrt(dr.fma(-sin_o, sin_o, 1)) * kappa
    s = sin_i * sin_o * kappa
    # 2 sinh(kappa) = exp(kappa) (1 - exp(-2 kappa)); in this form nothing overflows.
    return dr.exp(_log_bessel(c) - s - kappa) * kappa * (0.5 / math.pi) / (1 - dr.exp(-2 * kappa))


def _log_bessel(x: Float) -> Float:
    """The logarithm of the modified Bessel function I0, to 3e-5; x >= 0.

    Ten terms of the power series, sum of (x / 2)^(2 n) / (n!)^2, and beyond 7.5 the asymptotic expansion
    (https://dlmf.nist.gov/10.40.E1, in logarithms). Mitsuba takes fewer terms of it, and is off by up to 0.6 %.
    """
    quarter = 0.25 * dr.square(x)
    term, series = Float(1), Float(1)
    for n in range(1, 11):
        term = term * quarter / (n * n)
        series = series + term
    large = x > 7.5
    r = dr.rcp(dr.select(large, x, 1))
    tail = r * (1 / 8 + r * (1 / 16 + r * (25 / 384 + r * (13 / 128))))
    return dr.select(large, x + tail + 0.5 * dr.log(r * (0.5 / math.pi)), dr.log(series))
