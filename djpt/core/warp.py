"""Warps: maps from uniform samples on [0, 1) or [0, 1)^2 to other domains, their inverses, and their densities.

`square_to_X` is area-preserving up to the density `square_to_X_pdf`, which is 0 outside of the domain; `X_to_square`
undoes it. Samples may be Dr.Jit arrays, numbers, lists, tuples or NumPy arrays.
"""

from __future__ import annotations

import math

import drjit as dr

from djpt.core.frame import Frame3f, coordinate_system
from djpt.jit.kernels import maximum
from djpt.jit.types import Bool, Float, Normal3f, Point2f, Point3f, Vector3f, converting

__all__ = [
    "beckmann_to_square",
    "bilinear_to_square",
    "cosine_hemisphere_to_square",
    "direction_at",
    "interval_to_linear",
    "interval_to_nonuniform_tent",
    "interval_to_tangent_direction",
    "interval_to_tent",
    "linear_to_interval",
    "place_of",
    "square_to_beckmann",
    "square_to_beckmann_pdf",
    "square_to_bilinear",
    "square_to_bilinear_pdf",
    "square_to_cosine_hemisphere",
    "square_to_cosine_hemisphere_pdf",
    "square_to_rough_fiber",
    "square_to_rough_fiber_pdf",
    "square_to_std_normal",
    "square_to_std_normal_pdf",
    "square_to_tent",
    "square_to_tent_pdf",
    "square_to_uniform_cone",
    "square_to_uniform_cone_pdf",
    "square_to_uniform_disk",
    "square_to_uniform_disk_concentric",
    "square_to_uniform_disk_concentric_pdf",
    "square_to_uniform_disk_pdf",
    "square_to_uniform_hemisphere",
    "square_to_uniform_hemisphere_pdf",
    "square_to_uniform_sphere",
    "square_to_uniform_sphere_pdf",
    "square_to_uniform_spherical_lune",
    "square_to_uniform_spherical_lune_pdf",
    "square_to_uniform_square_concentric",
    "square_to_uniform_triangle",
    "square_to_uniform_triangle_pdf",
    "square_to_von_mises_fisher",
    "square_to_von_mises_fisher_pdf",
    "tangent_direction_to_interval",
    "tent_to_interval",
    "tent_to_square",
    "turns",
    "uniform_cone_to_square",
    "uniform_disk_to_square",
    "uniform_disk_to_square_concentric",
    "uniform_hemisphere_to_square",
    "uniform_sphere_to_square",
    "uniform_spherical_lune_to_square",
    "uniform_triangle_to_square",
    "von_mises_fisher_to_square",
]


# ---- lines and planes -------------------------------------------------------------------------


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


# ---- the unit disk: densities per unit area --------------------------------------------------


INV_PI = 1 / math.pi


@converting
def square_to_uniform_disk(sample: Point2f) -> Point2f:
    """A uniform point of the unit disk in polar coordinates: radius sqrt(sample.y), angle 2 pi sample.x."""
    r = dr.sqrt(sample.y)
    sin, cos = dr.sincos(2 * math.pi * sample.x)
    return Point2f(r * cos, r * sin)


@converting
def uniform_disk_to_square(p: Point2f) -> Point2f:
    """The inverse of `square_to_uniform_disk`."""
    return Point2f(turns(p.y, p.x), dr.squared_norm(p))


@converting
def square_to_uniform_disk_pdf(p: Point2f) -> Float:
    """The density 1 / pi on the unit disk, else 0."""
    return dr.select(dr.squared_norm(p) <= 1, Float(INV_PI), 0)


def _sincos_quarter(phi: Float) -> tuple[Float, Float]:
    """The sine and cosine for abs(phi) <= pi/4, without the range reduction of `dr.sincos`.

    Taylor polynomials of degree 9 and 8: the truncation error is below 2e-7 there.
    """
    z = dr.square(phi)
    sin = dr.fma(dr.fma(dr.fma(dr.fma(z, 1 / 362880, -1 / 5040), z, 1 / 120), z, -1 / 6), z * phi, phi)
    cos = dr.fma(dr.fma(dr.fma(dr.fma(z, 1 / 40320, -1 / 720), z, 1 / 24), z, -0.5), z, 1)
    return sin, cos


@converting
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


square_to_uniform_disk_concentric_pdf = square_to_uniform_disk_pdf


@converting
def uniform_disk_to_square_concentric(p: Point2f) -> Point2f:
    """The inverse of `square_to_uniform_disk_concentric`."""
    # The radius has the sign of the larger coordinate, and the angle is measured from that coordinate's axis.
    wide = dr.abs(p.x) > dr.abs(p.y)
    larger, smaller = dr.select(wide, p.x, p.y), dr.select(wide, p.y, p.x)
    r = dr.copysign(dr.norm(p), larger)
    other = (4 / math.pi) * dr.atan2(dr.mulsign(smaller, larger), dr.abs(larger)) * r
    return Point2f(dr.fma(0.5, dr.select(wide, r, other), 0.5), dr.fma(0.5, dr.select(wide, other, r), 0.5))


@converting
def square_to_uniform_square_concentric(sample: Point2f) -> Point2f:
    """Map concentric squares to lines of one y, by equal areas: (angle in turns, squared radius).

    These are polar coordinates of `square_to_uniform_disk_concentric`, so warps that take an angle and an area from
    the square distort less after this one.
    """
    x, y = dr.fma(2, sample.x, -1), dr.fma(2, sample.y, -1)
    swap = dr.abs(x) < dr.abs(y)
    r, other = dr.select(swap, y, x), dr.select(swap, x, y)
    phi = dr.select(r == 0, 0, 0.125 * other / r)
    phi = dr.select(swap, 0.25 - phi, phi)
    phi = dr.select(r < 0, phi + 0.5, phi)
    return Point2f(dr.select(phi < 0, phi + 1, phi), dr.square(r))


def turns(y: Float, x: Float) -> Float:
    """The angle of the direction (x, y) in [0, 1), as a fraction of a turn."""
    phi = dr.atan2(y, x) * (0.5 * INV_PI)
    return dr.select(phi < 0, phi + 1, phi)


# ---- the sphere, the hemisphere and cones about +z: densities per unit solid angle -----------


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


# ---- lobes of directions about +z: densities per unit solid angle ----------------------------


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


# ---- edges of surfaces: tangents of one face, and the lunes between the planes of two --------


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
    half = 0.5 * _angle(n1, n2)
    return dr.select(dr.dot(d, n1) * dr.dot(d, n2) <= 0, dr.rcp(8 * half), 0)


def _lune(n1: Normal3f, n2: Normal3f) -> tuple[Vector3f, Vector3f, Vector3f, Float]:
    """A frame (middle of the first lune, mean of the normals, edge), and half of the angle of a lune."""
    z = dr.normalize(dr.cross(n1, n2))
    y = dr.normalize(n1 + n2)
    return dr.cross(z, y), y, z, 0.5 * _angle(n1, n2)


def _angle(n1: Normal3f, n2: Normal3f) -> Float:
    """The angle between two normals, also where it is small."""
    return dr.atan2(dr.norm(dr.cross(n1, n2)), dr.dot(n1, n2))


# ---- the square [-1, 1]^2 as the octahedron of directions ------------------------------------


def direction_at(place: Point2f) -> Vector3f:
    """The unit vector at a point of the square [-1, 1]^2, computed without an angle.

    A direction is projected from the centre to the octahedron |x| + |y| + |z| = 1, whose upper half is the inner
    diamond of the square, |u| + |v| <= 1; the lower half is folded outwards. A piece du dv of the square covers the
    solid angle s^3 du dv, with s = |x| + |y| + |z| of the unit vector, between 1 and 3 sqrt(3) (E. Praun and H. Hoppe,
    "Spherical Parametrization and Remeshing", SIGGRAPH 2003).
    """
    z = 1 - dr.abs(place.x) - dr.abs(place.y)
    below = maximum(-z, 0.0)
    return dr.normalize(Vector3f(place.x - dr.mulsign(below, place.x), place.y - dr.mulsign(below, place.y), z))


def place_of(d: Vector3f) -> tuple[Point2f, Float]:
    """The point of a unit vector, and the solid angle per area of the square there."""
    s = dr.abs(d.x) + dr.abs(d.y) + dr.abs(d.z)
    inverse = dr.rcp(s)
    x, y = d.x * inverse, d.y * inverse
    folded = Point2f(dr.mulsign(1 - dr.abs(y), x), dr.mulsign(1 - dr.abs(x), y))
    return dr.select(d.z < 0, folded, Point2f(x, y)), s * s * s
