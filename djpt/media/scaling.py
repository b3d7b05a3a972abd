"""The factor `scale` of a medium's extinction."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.numeric import non_negative
from djpt.jit.frozen import recording
from djpt.jit.types import Float

__all__ = ["as_scale"]


def as_scale(value: Any) -> Float:
    """Convert an edited `scale`; gradients are kept.

    Raises:
        SceneError: Not one finite number that is at least 0.
    """
    if recording():
        return Float(value)
    attached = dr.is_array_v(value) and dr.grad_enabled(value)
    number = non_negative(dr.detach(value) if attached else value)
    return Float(value) if attached else dr.opaque(Float, number)
