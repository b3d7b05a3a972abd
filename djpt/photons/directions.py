"""Directions in one word of memory: places on an octahedron, unfolded to a square.

The largest error is 6.5e-5 radians: half a step of both coordinates, and of the third one their sum, in the middle of a
face, which is 1 / sqrt(3) from the centre. Directions along the axes are exact.

Z. H. Cigolle, S. Donow, D. Evangelakos, M. Mara, M. McGuire and Q. Meyer, "A Survey of Efficient Representations for
Independent Unit Vectors", 2014.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.types import Float, Int32, UInt32, Vector3f

__all__ = ["packed", "unpacked"]

DIGITS = 16
"""Binary digits of a coordinate."""

HALF = 2 ** (DIGITS - 1) - 1
"""The steps from the square's centre to its side."""


def packed(d: Vector3f) -> Float:
    """A unit vector in the bits of a `Float`, which isn't a number to compute with."""
    scale = dr.rcp(dr.abs(d.x) + dr.abs(d.y) + dr.abs(d.z))
    x, y = d.x * scale, d.y * scale
    # The lower half of the octahedron is folded outwards.
    below = d.z < 0
    u = dr.select(below, dr.mulsign(1 - dr.abs(y), x), x)
    v = dr.select(below, dr.mulsign(1 - dr.abs(x), y), y)
    low, high = (UInt32(Int32(dr.round(dr.fma(c, HALF, HALF)))) for c in (u, v))
    word: Any = dr.reinterpret_array(Float, low | (high << DIGITS))
    return Float(word)


def unpacked(word: Float) -> Vector3f:
    """The unit vector that `packed` has put into a word."""
    bits: Any = dr.reinterpret_array(UInt32, word)
    u, v = (dr.fma(Float(Int32(c)), 1 / HALF, -1) for c in (bits & (2**DIGITS - 1), bits >> DIGITS))
    z = 1 - dr.abs(u) - dr.abs(v)
    fold = dr.maximum(-z, 0)
    return Vector3f(dr.normalize(Vector3f(u - dr.mulsign(fold, u), v - dr.mulsign(fold, v), z)))
