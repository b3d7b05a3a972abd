"""Arrays between NumPy and Dr.Jit, so that no kernel depends on their size or place.

`np.array` of a vector interleaves its components by a kernel that knows their number, and a kernel that reads memory
shared with NumPy knows whether it is aligned: both are compiled again for each size and place.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from djpt.jit.types import Float

__all__ = ["floats", "in_numpy", "rows"]

LINE = 64
"""Bytes that Dr.Jit's own memory is aligned to."""


def floats(values: Any) -> Float:
    """Numbers in aligned memory."""
    values = np.asarray(values, np.float32).ravel()
    memory = np.empty(values.nbytes + LINE, np.uint8)
    start = -memory.ctypes.data % LINE
    aligned = memory[start : start + values.nbytes].view(np.float32)
    aligned[:] = values
    return Float(aligned)


def rows(values: Any) -> tuple[Float, ...]:
    """The rows of a matrix in aligned memory: the components of a vector per lane."""
    return tuple(floats(row) for row in values)


def in_numpy(value: Any) -> np.ndarray:
    """A number or a vector per lane as (lanes,) or (components, lanes), in double precision."""
    if dr.depth_v(value) <= 1:
        return np.array(value, np.float64)
    parts = [np.array(part, np.float64) for part in value]
    return np.stack(np.broadcast_arrays(*parts))
