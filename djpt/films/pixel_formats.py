"""Pixel formats: the channels that colours are stored in."""

from __future__ import annotations

from djpt.core.color import LUMINANCE, RGB_TO_XYZ

__all__ = ["CHANNELS", "ROWS"]

CHANNELS = {
    "rgb": ("R", "G", "B"),
    "rgba": ("R", "G", "B", "A"),
    "luminance": ("Y",),
    "luminance_alpha": ("Y", "A"),
    "xyz": ("X", "Y", "Z"),
    "xyza": ("X", "Y", "Z", "A"),
}
"""The names of the channels of a pixel format; A is the fraction of samples that are covered."""

ROWS = {"luminance": (LUMINANCE,), "luminance_alpha": (LUMINANCE,), "xyz": RGB_TO_XYZ, "xyza": RGB_TO_XYZ}
"""The weights of red, green and blue in each channel, for formats that don't store these three."""
