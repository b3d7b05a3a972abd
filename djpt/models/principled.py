"""What other descriptions of a surface are as parameters of `principled`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

__all__ = ["COAT", "SMALLEST_ETA", "eta_of", "gloss_of"]

COAT = 0.1
"""The largest alpha of the coat of `principled`."""
SMALLEST_ETA = 1.01
"""An interface that reflects nothing would be none, for metals as well."""


def eta_of(reflectance: float) -> float:
    """The relative index of refraction with a reflectance at normal incidence, of at most 0.9."""
    root = math.sqrt(min(reflectance, 0.9))
    return max((1 + root) / (1 - root), SMALLEST_ETA)


def gloss_of(roughness: Any) -> Any:
    """The gloss of a clear coat of a roughness: `principled` makes alpha = 0.1 + gloss (0.001 - 0.1) of it."""
    return np.clip((COAT - roughness**2) / (COAT - 0.001), 0, 1)
