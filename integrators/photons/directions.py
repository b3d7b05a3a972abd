"""Directions in one word of memory: places on an octahedron, unfolded to a square.

The largest error is 6.5e-5 radians: half a step of both coordinates, and of the third one their sum, in the middle of a
face, which is 1 / sqrt(3) from the centre. Directions along the axes are exact.

Z. H. Cigolle, S. Donow, D. Evangelakos, M. Mara, M. McGuire and Q. Meyer, "A Survey of Efficient Representations for
Independent Unit Vectors", 2014.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.warp import direction_at, place_of
from djpt.jit.types import Float, Int32, Point2f, UInt32, Vector3f

__all__ = ["coded", "decoded", "packed", "unpacked"]

DIGITS = 16
"""Binary digits of a coordinate of a direction that fills a word."""


def coded(d: Vector3f, digits: int) -> UInt32:
    """A unit vector in a whole number with twice as many binary `digits` as each of its two coordinates has."""
    half = half_of(digits)
    low, high = (UInt32(Int32(dr.round(dr.fma(c, half, half)))) for c in place_of(d)[0])
    return low | (high << digits)


def decoded(bits: UInt32, digits: int) -> Vector3f:
    """The unit vector encoded by `coded`."""
    inverse = 1 / half_of(digits)
    u, v = (dr.fma(Float(Int32(c)), inverse, -1) for c in (bits & (2**digits - 1), bits >> digits))
    return direction_at(Point2f(u, v))


def packed(d: Vector3f) -> Float:
    """A unit vector stored in the bits of a `Float`, which isn't meaningful as a number."""
    word: Any = dr.reinterpret_array(Float, coded(d, DIGITS))
    return Float(word)


def unpacked(word: Float) -> Vector3f:
    """The unit vector stored by `packed`."""
    bits: Any = dr.reinterpret_array(UInt32, word)
    return decoded(UInt32(bits), DIGITS)


def half_of(digits: int) -> int:
    """The steps from the square's centre to its side."""
    return int(2 ** (digits - 1) - 1)
