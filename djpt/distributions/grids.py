"""Tables over grids of numbers, built by compiled functions or, without LLVM, by NumPy: the same to the last bit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.color import LUMINANCE
from djpt.distributions.grid_functions import PARAMETERS, add_grid_functions
from djpt.jit.kernels import aligned_floats
from djpt.jit.llvm.host import HostFunctions

__all__ = ["cell_masses", "corner_table", "halve", "luminance", "side_by_side"]

FUNCTIONS = HostFunctions(add_grid_functions, PARAMETERS, small=1 << 12, few=1 << 12)
"""What works on grids of many cells; others are left to NumPy."""

Numbers = NDArray[np.float64]
Table = NDArray[np.float32]


def luminance(texels: NDArray[Any]) -> Numbers:
    """The weights of texels (H, W, 1 or 3) that are cells themselves, as in Mitsuba, at least 0; (H, W)."""
    rows, columns, channels = texels.shape
    run = FUNCTIONS.for_size(rows * columns)
    if run is not None and channels == 3 and texels.dtype == np.float32 and texels.strides[1:] == (12, 4):
        weights = np.empty((rows, columns))
        run("weigh", texels, np.array(LUMINANCE, np.float64), weights, np.array([rows, columns]), texels.strides[0])
        return weights
    weights = np.zeros((rows, columns))
    for k, share in enumerate([1.0] if channels == 1 else LUMINANCE):
        weights += share * texels[..., k].astype(np.float64)
    return np.maximum(weights, 0, out=weights)


def cell_masses(numbers: Numbers) -> Numbers:
    """The averages (rows, columns) of the numbers (rows + 1, columns + 1) at the corners of cells."""
    rows, columns = numbers.shape[0] - 1, numbers.shape[1] - 1
    run = FUNCTIONS.for_size(rows * columns)
    if run is None:
        return (numbers[:-1, :-1] + numbers[:-1, 1:] + numbers[1:, :-1] + numbers[1:, 1:]) / 4
    masses = np.empty((rows, columns))
    run("average", np.ascontiguousarray(numbers), masses, rows, columns)
    return masses


def corner_table(numbers: Numbers) -> Table:
    """The numbers at the corners of each cell side by side, (rows, columns, 4), in aligned memory.

    They are in the order upper left, upper right, lower left, lower right.
    """
    rows, columns = numbers.shape[0] - 1, numbers.shape[1] - 1
    single, table = numbers.astype(np.float32), aligned_floats((rows, columns, 4))
    run = FUNCTIONS.for_size(rows * columns)
    if run is not None:
        run("gather_corners", np.ascontiguousarray(single), table, rows, columns)
        return table
    for k, column in enumerate((single[:-1, :-1], single[:-1, 1:], single[1:, :-1], single[1:, 1:])):
        table[..., k] = column
    return table


def halve(mass: Numbers, nodes: Table) -> Numbers:
    """Write the nodes over cells in twos or, where there are several rows and columns, in fours; give their masses.

    A node is the fraction of the upper half, and of the left half of either; 0 where there is no mass: no sample
    arrives there. Its fourth number stays 0.

    Args:
        mass: of the cells, (rows, columns), powers of two.
        nodes: contiguous, half as many rows and columns (or one), with 4 numbers each, all 0.
    """
    rows, columns = mass.shape
    run = FUNCTIONS.for_size(mass.size)
    if run is not None and rows > 1 and columns > 1:
        totals = np.empty((rows // 2, columns // 2))
        run("halve", np.ascontiguousarray(mass), nodes, totals, rows // 2, columns // 2)
        return totals
    if 1 in mass.shape:
        mass = np.pad(mass, ((0, rows % 2), (0, columns % 2)))
    upper, lower = mass[::2], mass[1::2]
    halves = [half[:, ::2] + half[:, 1::2] for half in (upper, lower)]
    total = halves[0] + halves[1]
    parts = ((halves[0], total), (upper[:, ::2], halves[0]), (lower[:, ::2], halves[1]))
    for k, (part, whole) in enumerate(parts):
        nodes[..., k] = np.divide(part, whole, out=np.zeros_like(whole), where=whole > 0)
    return total


def side_by_side(texels: NDArray[Any], numbers: Numbers) -> Table:
    """Texels (H, W, 3) and numbers (H, W) as a table (H, W, 4), in aligned memory."""
    rows, columns, _ = texels.shape
    table, run = aligned_floats((rows, columns, 4)), FUNCTIONS.for_size(rows * columns)
    if run is not None and texels.dtype == np.float32 and texels.strides[1:] == (12, 4) and numbers.strides[1] == 8:
        strides = np.array([texels.strides[0], numbers.strides[0]])
        run("join", texels, numbers, table, np.array([rows, columns]), strides)
        return table
    table[..., :3], table[..., 3] = texels, numbers
    return table
