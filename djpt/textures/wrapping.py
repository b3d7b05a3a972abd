"""Grids beyond their borders."""

from __future__ import annotations

import drjit as dr

from djpt.jit.kernels import maximum, minimum
from djpt.jit.types import Float, UInt32

__all__ = ["WRAP_MODES", "wrapped"]

WRAP_MODES = ("repeat", "mirror", "clamp")
"""Values beyond the border: the grid again, its mirror image, or the last point."""


def wrapped(i: Float, count: Float, mode: str) -> UInt32:
    """The number of a point along an axis that has `count` of them; `i` is whole, but may lie outside."""
    if mode == "repeat":
        i = remainder(i, count)
    elif mode == "mirror":
        i = remainder(i, 2 * count)
        i = minimum(i, 2 * count - 1 - i)
    # Also for safety: no coordinate whatsoever may lead out of memory.
    return UInt32(minimum(maximum(i, 0), count - 1))


def remainder(i: Float, n: Float) -> Float:
    """The remainder of `i` by `n`, whole numbers up to some millions: half a unit keeps off the steps of floor."""
    return dr.fma(-n, dr.floor((i + 0.5) * dr.rcp(n)), i)
