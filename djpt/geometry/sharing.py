"""Memory that NumPy and kernels share."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.types import Float, UInt32

__all__ = ["aligned", "float_in", "shared"]


def aligned(shape: tuple[int, ...]) -> NDArray[np.uint32]:
    """Zeros in memory that starts at a multiple of 64 bytes.

    Dr.Jit shares NumPy's memory, and whether it is aligned is part of a kernel: the same code would be
    compiled several times. Also, only aligned memory has packet loads.
    """
    count = math.prod(shape)
    room = np.zeros(count + 16, np.uint32)
    first = (-room.ctypes.data % 64) // 4
    return room[first : first + count].reshape(shape)


def shared(values: NDArray[np.uint32]) -> UInt32:
    """A copy of an array for kernels."""
    copy = aligned(values.shape)
    copy[...] = values
    return UInt32(copy.ravel())


def float_in(word: UInt32) -> Float:
    """The float whose bits a word holds."""
    number: Any = dr.reinterpret_array(Float, word)
    return number
