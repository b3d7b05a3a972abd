"""Lengths and points of a working frame in the coordinates of the scene's description, for what shows them."""

from __future__ import annotations

import drjit as dr
import numpy as np

from djpt.jit.kernels import as_float, as_vector
from djpt.jit.types import Float, Point3f
from djpt.scene.normalization.frame import WorkingFrame

__all__ = ["Units"]


class Units:
    """The inverse of a `WorkingFrame`, in kernels."""

    def __init__(self, frame: WorkingFrame) -> None:
        self._unit, self._center = as_float(1 / frame.scale), as_vector(np.array(frame.center))

    def length(self, x: Float) -> Float:
        """A length."""
        return x * self._unit

    def point(self, p: Point3f) -> Point3f:
        """A point."""
        return dr.fma(p, self._unit, self._center)
