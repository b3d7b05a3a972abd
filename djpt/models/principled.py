"""What other descriptions of a surface are as parameters of `principled`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from djpt.models.model import Matrix

__all__ = ["COAT", "SHEEN", "SMALLEST_ETA", "eta_of", "gloss_of", "luminance", "of_hue"]

COAT = 0.1
"""The largest alpha of the coat of `principled`."""
SMALLEST_ETA = 1.01
"""An interface that reflects nothing would be none, for metals as well."""
SHEEN = 0.2
"""Roughly the albedo of a white sheen."""


def eta_of(reflectance: float) -> float:
    """The relative index of refraction with a reflectance at normal incidence, of at most 0.9."""
    root = math.sqrt(min(reflectance, 0.9))
    return max((1 + root) / (1 - root), SMALLEST_ETA)


def gloss_of(roughness: Any) -> Any:
    """The gloss of a clear coat of a roughness: `principled` makes alpha = 0.1 + gloss (0.001 - 0.1) of it."""
    return np.clip((COAT - roughness**2) / (COAT - 0.001), 0, 1)


def luminance(color: Matrix) -> float:
    """The luminance of a linear colour, (3,)."""
    return float(color @ (0.212671, 0.715160, 0.072169))


def of_hue(base: Matrix, lobe: Matrix) -> Matrix:
    """The colours with the hue of a lobe's colour, (3,), that are nearest to others, (.., 3); none is black."""
    found: Matrix = np.maximum(base @ lobe / (lobe @ lobe), 1e-3)[..., None] * lobe
    return found
