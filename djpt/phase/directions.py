"""Directions at an angle to the light that is scattered."""

from __future__ import annotations

import math

import drjit as dr

from djpt.core.records.interactions import MediumInteraction3f
from djpt.jit.types import Float, Vector3f

__all__ = ["around"]


def around(mi: MediumInteraction3f, cosine: Float, turn: Float) -> Vector3f:
    """The world direction whose cosine with `mi.wi` is `cosine`, turned about `mi.wi` by `turn` in [0, 1)."""
    sine = dr.safe_sqrt(dr.fma(-cosine, cosine, 1))
    sin_phi, cos_phi = dr.sincos(2 * math.pi * turn)
    return mi.to_world(Vector3f(sine * cos_phi, sine * sin_phi, cosine))
