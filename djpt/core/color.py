"""Constants of the colour space, linear sRGB."""

from __future__ import annotations

__all__ = ["LUMINANCE", "RGB_TO_XYZ"]

LUMINANCE = (0.212671, 0.715160, 0.072169)
"""Weights of red, green and blue in the luminance of linear sRGB (ITU-R BT.709)."""

RGB_TO_XYZ = ((0.412453, 0.357580, 0.180423), LUMINANCE, (0.019334, 0.119193, 0.950227))
"""CIE XYZ (1931) of the primaries of linear sRGB, row by row (ITU-R BT.709, white point D65)."""
