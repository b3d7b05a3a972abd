"""Pixel formats: the channels that colours are stored in."""

from __future__ import annotations

from djpt.images.color import LUMINANCE

__all__ = ["CHANNELS", "ROWS"]

CHANNELS = {
    "rgb": ("R", "G", "B"),
    "rgba": ("R", "G", "B", "A"),
    "luminance": ("Y",),
    "luminance_alpha": ("Y", "A"),
    "xyz": ("X", "Y", "Z"),
    "xyza": ("X", "Y", "Z", "A"),
}
"""The names of the channels of a pixel format; A is the share of samples that are covered."""

XYZ = ((0.412453, 0.357580, 0.180423), LUMINANCE, (0.019334, 0.119193, 0.950227))
"""CIE XYZ (1931) of the primaries of linear sRGB, row by row (ITU-R BT.709)."""

ROWS = {"luminance": (LUMINANCE,), "luminance_alpha": (LUMINANCE,), "xyz": XYZ, "xyza": XYZ}
"""The weights of red, green and blue in each channel, for formats that don't store these three."""
