"""Constants of the colour space, linear sRGB."""

from __future__ import annotations

__all__ = ["LUMINANCE"]

LUMINANCE = (0.212671, 0.715160, 0.072169)
"""Weights of red, green and blue in the luminance of linear sRGB (ITU-R BT.709)."""
