"""Warps of the unit interval and the unit square to densities on lines and planes, their inverses, and densities."""

from __future__ import annotations

import math

import drjit as dr

from djpt.jit.types import Bool, Float, Point2f, converting

__all__ = [
    "bilinear_to_square",
    "interval_to_linear",
    "interval_to_nonuniform_tent",
    "interval_to_tent",
    "linear_to_interval",
    "square_to_bilinear",
    "square_to_bilinear_pdf",
    "square_to_std_normal",
    "square_to_std_normal_pdf",
    "square_to_tent",
    "square_to_tent_pdf",
    "square_to_uniform_triangle",
    "square_to_uniform_triangle_pdf",
    "tent_to_interval",
    "tent_to_square",
    "uniform_triangle_to_square",
]


@converting
def square_to_tent(sample: Point2f) -> Point2f:
    """A point on [-1, 1]^2 whose coordinates have the tent density 1 - abs(x): the weights of bilinear lookups."""
    return Point2f(_tent(sample.x), _tent(sample.y))


def _tent(sample: Float) -> Float:
    centred = sample - 0.5
    return dr.mulsign(1 - dr.safe_sqrt(dr.fma(dr.abs(centred), -2, 1)), centred)


@converting
def square_to_tent_pdf(v: Point2f) -> Float:
    """The density (1 - abs(x)) (1 - abs(y)) on [-1, 1]^2, per unit area."""
    x, y = 1 - dr.abs(v.x), 1 - dr.abs(v.y)
    return dr.select((x > 0) & (y > 0), x * y, 0)


@converting
def square_to_uniform_triangle(sample: Point2f) -> Point2f:
    """Uniform barycentric coordinates (b1, b2) of a triangle: b1 = 1 - sqrt(1 - x), b2 = y sqrt(1 - x)."""
    t = dr.safe_sqrt(1 - sample.x)
    return Point2f(1 - t, t * sample.y)


@converting
def square_to_uniform_triangle_pdf(p: Point2f) -> Float:
    """The density 2 on the triangle of barycentric coordinates, per unit of their area."""
    return dr.select((p.x >= 0) & (p.y >= 0) & (p.x + p.y <= 1), Float(2), 0)


@converting
def uniform_triangle_to_square(p: Point2f) -> Point2f:
    """The inverse of `square_to_uniform_triangle`."""
    t = 1 - p.x
    return Point2f(1 - dr.square(t), p.y / t)


@converting
def interval_to_tent(sample: Float) -> Float:
    """A number in [-1, 1] with the density 1 - abs(x)."""
    return _tent(sample)


@converting
def tent_to_interval(value: Float) -> Float:
    """The inverse of `interval_to_tent`: the distribution function of the tent."""
    return 0.5 * (1 + value * (2 - dr.abs(value)))


@converting
def tent_to_square(value: Point2f) -> Point2f:
    """The inverse of `square_to_tent`."""
    return Point2f(tent_to_interval(value.x), tent_to_interval(value.y))


@converting
def interval_to_nonuniform_tent(a: Float, b: Float, c: Float, d: Float) -> Float:
    """A number in [a, c] whose density rises linearly from a to b and falls from b to c, by the sample `d`."""
    rising = d * (c - a) < b - a
    side = dr.select(rising, a - b, c - b)
    # What is left of the sample on its side of the peak, as a fraction of that side.
    share = dr.select(rising, d * (a - c) / (a - b), ((a - c) / (b - c)) * (d - (a - b) / (a - c)))
    return b + side * (1 - dr.safe_sqrt(share))


@converting
def interval_to_linear(v0: Float, v1: Float, sample: Float) -> Float:
    """A number in [0, 1] with a density proportional to the straight line from `v0` (at 0) to `v1` (at 1)."""
    root = dr.safe_sqrt(dr.lerp(dr.square(v0), dr.square(v1), sample))
    return dr.select(_sloped(v0, v1), (v0 - root) / (v0 - v1), sample)


@converting
def linear_to_interval(v0: Float, v1: Float, sample: Float) -> Float:
    """The inverse of `interval_to_linear`."""
    return dr.select(_sloped(v0, v1), sample * ((2 - sample) * v0 + sample * v1) / (v0 + v1), sample)


def _sloped(v0: Float, v1: Float) -> Bool:
    """True where a line from `v0` to `v1` is steep enough for its inversion to be exact."""
    return dr.abs(v0 - v1) > 1e-4 * (v0 + v1)


@converting
def square_to_bilinear(v00: Float, v10: Float, v01: Float, v11: Float, sample: Point2f) -> tuple[Point2f, Float]:
    """A point of the unit square with a density proportional to the bilinear interpolation of its corners.

    `v10` is the value at (1, 0). The ordinate is chosen by its marginal density, then the abscissa.

    Returns:
        The point, and the interpolation there: the density if the mean of the corners is 1.
    """
    y = interval_to_linear(v00 + v10, v01 + v11, sample.y)
    left, right = dr.lerp(v00, v01, y), dr.lerp(v10, v11, y)
    x = interval_to_linear(left, right, sample.x)
    return Point2f(x, y), dr.lerp(left, right, x)


@converting
def bilinear_to_square(v00: Float, v10: Float, v01: Float, v11: Float, sample: Point2f) -> tuple[Point2f, Float]:
    """The inverse of `square_to_bilinear`: the sample that leads to a point, and the interpolation at the point."""
    left, right = dr.lerp(v00, v01, sample.y), dr.lerp(v10, v11, sample.y)
    origin = Point2f(linear_to_interval(left, right, sample.x), linear_to_interval(v00 + v10, v01 + v11, sample.y))
    return origin, dr.lerp(left, right, sample.x)


@converting
def square_to_bilinear_pdf(v00: Float, v10: Float, v01: Float, v11: Float, sample: Point2f) -> Float:
    """The bilinear interpolation of the corners at a point of the unit square."""
    return dr.lerp(dr.lerp(v00, v10, sample.x), dr.lerp(v01, v11, sample.x), sample.y)


@converting
def square_to_std_normal(v: Point2f) -> Point2f:
    """A point with the normal density exp(-abs(p)^2 / 2) / (2 pi).

    G. E. P. Box and M. E. Muller, "A Note on the Generation of Random Normal Deviates", 1958.
    """
    r = dr.sqrt(-2 * dr.log(1 - v.x))
    sin, cos = dr.sincos(2 * math.pi * v.y)
    return Point2f(r * cos, r * sin)


@converting
def square_to_std_normal_pdf(v: Point2f) -> Float:
    """The density of `square_to_std_normal`."""
    return (0.5 / math.pi) * dr.exp(-0.5 * dr.squared_norm(v))
