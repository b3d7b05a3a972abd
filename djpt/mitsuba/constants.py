"""Constants of Mitsuba 3.9.1: the version that djpt is compatible with, and numbers that scripts use."""

from __future__ import annotations

from typing import Final

__all__ = [
    "DEBUG",
    "MI_AUTHORS",
    "MI_CIE_D65_NORMALIZATION",
    "MI_CIE_MAX",
    "MI_CIE_MIN",
    "MI_CIE_Y_NORMALIZATION",
    "MI_ENABLE_CUDA",
    "MI_ENABLE_EMBREE",
    "MI_ENABLE_METAL",
    "MI_FILTER_RESOLUTION",
    "MI_VERSION",
    "MI_VERSION_MAJOR",
    "MI_VERSION_MINOR",
    "MI_VERSION_PATCH",
    "MI_YEAR",
]

MI_VERSION_MAJOR: Final = 3
MI_VERSION_MINOR: Final = 9
MI_VERSION_PATCH: Final = 1
MI_VERSION: Final = f"{MI_VERSION_MAJOR}.{MI_VERSION_MINOR}.{MI_VERSION_PATCH}"
MI_YEAR: Final = "2024"
MI_AUTHORS: Final = "Realistic Graphics Lab, EPFL"
"""Year and authors of the Mitsuba whose meaning counts here."""

DEBUG: Final = False
MI_ENABLE_CUDA: Final = True
MI_ENABLE_METAL: Final = False
MI_ENABLE_EMBREE: Final = False
"""False, as opposed to Mitsuba: djpt searches with code of its own."""

MI_CIE_MIN: Final = 360.0
MI_CIE_MAX: Final = 830.0
"""The range of the CIE's tables, in nanometres."""

MI_CIE_Y_NORMALIZATION: Final = 1.0 / 106.7502593994140625
"""One over the integral of the CIE's luminosity function."""

MI_CIE_D65_NORMALIZATION: Final = 0.010101273599490354
"""One over the luminance of the illuminant D65 of the CIE's tables."""

MI_FILTER_RESOLUTION: Final = 31
"""Steps in which Mitsuba tabulates reconstruction filters; djpt has no tables."""
