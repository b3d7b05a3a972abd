"""The angle between a direction and the sun, exact for small angles, too."""

from __future__ import annotations

import drjit as dr

from djpt.jit.kernels import minimum
from djpt.jit.types import Float, Vector3f

__all__ = ["angle", "cosine", "squared_chord", "squared_sine"]


def squared_chord(a: Vector3f, b: Vector3f) -> Float:
    """The squared distance of two unit vectors, which the functions below take: 2 - 2 cos."""
    return dr.squared_norm(a - b)


def cosine(chord2: Float) -> Float:
    """The cosine of the angle between them."""
    return dr.fma(chord2, -0.5, 1)


def squared_sine(chord2: Float) -> Float:
    """The squared sine of the angle between them."""
    return chord2 * dr.fma(chord2, -0.25, 1)


def angle(chord2: Float) -> Float:
    """The angle between them, in radians."""
    return 2 * dr.asin(minimum(0.5 * dr.sqrt(chord2), Float(1)))
