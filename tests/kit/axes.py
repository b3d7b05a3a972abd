"""Axes of rotations."""

from __future__ import annotations

import math

__all__ = ["unit"]


def unit(x: float, y: float, z: float) -> list[float]:
    """The vector (x, y, z), scaled to the length 1."""
    length = math.sqrt(x * x + y * y + z * z)
    return [x / length, y / length, z / length]
