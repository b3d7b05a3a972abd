"""The encoding of sRGB (IEC 61966-2-1) in kernels; `djpt.images.srgb` has that of pixels on the host."""

from __future__ import annotations

from typing import Any

import drjit as dr

__all__ = ["linear_to_srgb", "srgb_to_linear"]


def linear_to_srgb(arg: Any, /) -> Any:
    """The encoding of sRGB, not clipped: of a number, of three numbers (a `drjit.scalar.Array3f`) or of an array."""
    x = plain(arg)
    return dr.select(x <= 0.0031308, 12.92 * x, 1.055 * dr.power(dr.maximum(x, 0.0031308), 1 / 2.4) - 0.055)


def srgb_to_linear(arg: Any, /) -> Any:
    """The inverse of `linear_to_srgb`."""
    x = plain(arg)
    return dr.select(x <= 0.04045, x / 12.92, dr.power((dr.maximum(x, 0.04045) + 0.055) / 1.055, 2.4))


def plain(value: Any) -> Any:
    """A number, a vector of three of them, or an array as it is."""
    if dr.is_array_v(value) or isinstance(value, (int, float)):
        return value
    return dr.scalar.Array3f(value)
