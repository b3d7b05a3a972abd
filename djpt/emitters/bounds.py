"""Bounds of an emitter's light, its origins and directions, for estimates of its importance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["LightBounds"]


@dataclass(frozen=True)
class LightBounds:
    """A box that holds the emitter, and a cone that holds the directions of its light.

    The normals of what shines lie within `theta_o` of `axis`, and light leaves within `theta_e` of a
    normal (A. Conty Estevez and C. Kulla, "Importance Sampling of Many Lights with Adaptive Tree
    Splitting", 2018). World space; angles in radians.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    axis: NDArray[np.float64]
    """The cone's axis, of unit length."""
    theta_o: float
    theta_e: float
    power: float
    """The emitted power in W, an estimate: see `Emitter.power`."""
