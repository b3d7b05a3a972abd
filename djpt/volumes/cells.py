"""Largest numbers in the cells of a coarse grid: bounds of the extinction, which trackers need."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["maxima_of_cells"]


def maxima_of_cells(numbers: NDArray[np.float32], counts: Sequence[int], wrap_mode: str) -> NDArray[np.float32]:
    """The maxima of a grid over the cells of a coarser one.

    Args:
        numbers: (Z, Y, X).
        counts: the numbers of cells along x, y and z, over the same box.
        wrap_mode: what lies beyond the border: 'clamp', 'repeat' or 'mirror'.

    Returns:
        (counts[2], counts[1], counts[0]): the maximum of all numbers that interpolation within the cell reads.
    """
    for axis, count in enumerate(reversed(counts)):
        size = numbers.shape[axis]
        slabs = [numbers.take(points(k, count, size, wrap_mode), axis).max(axis) for k in range(count)]
        numbers = np.stack(slabs, axis)
    return numbers


def points(k: int, count: int, size: int, wrap_mode: str) -> NDArray[np.int64]:
    """The numbers of the points along an axis that interpolation reads within cell k of `count`."""
    # Kernels compute in single precision: places on a border may belong to either cell.
    margin = 1e-5 * size
    first = int(np.floor(k / count * size - 0.5 - margin))
    last = int(np.floor((k + 1) / count * size - 0.5 + margin)) + 1
    found = np.arange(first, last + 1)
    if wrap_mode == "repeat":
        return found % size
    if wrap_mode == "mirror":
        found = found % (2 * size)
        return np.minimum(found, 2 * size - 1 - found)
    return np.clip(found, 0, size - 1)
