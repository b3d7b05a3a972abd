"""Warps of the unit square to the unit disk, their inverses, and densities per unit area."""

from __future__ import annotations

import math

import drjit as dr

from djpt.jit.types import Float, Point2f, converting

__all__ = [
    "square_to_uniform_disk",
    "square_to_uniform_disk_concentric",
    "square_to_uniform_disk_concentric_pdf",
    "square_to_uniform_disk_pdf",
    "square_to_uniform_square_concentric",
    "turns",
    "uniform_disk_to_square",
    "uniform_disk_to_square_concentric",
]

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


@converting
def square_to_uniform_disk_concentric_pdf(p: Point2f) -> Float:
    """The density 1 / pi on the unit disk, per unit area."""
    return dr.select(dr.squared_norm(p) <= 1, Float(INV_PI), 0)


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
