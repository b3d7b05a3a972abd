"""Tables over grids of numbers, built by compiled functions or, without LLVM, by NumPy: the same to the last bit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.color import LUMINANCE
from djpt.jit.kernels import aligned_floats
from djpt.jit.llvm.arithmetic import maximum
from djpt.jit.llvm.host import HostFunctions
from djpt.jit.llvm.ir import F32, F64, I64, PTR, Function, Module, Type, Value

__all__ = ["PARAMETERS", "add_grid_functions", "cell_masses", "corner_table", "halve", "luminance", "side_by_side"]

PARAMETERS = {"weigh": 5, "average": 4, "gather_corners": 4, "halve": 5, "join": 5}
"""The functions, and how many parameters each has."""

ENTRY = 16
"""Bytes of an entry of a table."""


def add_grid_functions(module: Module) -> None:
    """Add the functions to a module.

    Numbers have double precision and tables single precision, unless noted; grids lie in memory row by row, and an
    entry of a table is four floats.
    """
    add_weigh(module)
    add_average(module)
    add_gather_corners(module)
    add_halve(module)
    add_join(module)


def add_weigh(module: Module) -> None:
    """Add up the three channels of texels (single precision), each times its fraction, and cut at 0.

    `stride`: bytes from one row of texels to the next.
    """
    names = [("texels", PTR), ("shares", PTR), ("target", PTR), ("size", PTR), ("stride", I64)]
    with module.function("weigh", names, I64) as f:
        texels, shares, target, size, stride = f.parameters
        rows, columns = f.load(I64, size), f.load(I64, size.at(8))
        factors = [f.load(F64, shares.at(8 * k)) for k in range(3)]
        with f.each(0, rows) as i:
            source, row = texels.at(i * stride), target.at(i * columns * 8)
            with f.each(0, columns) as j:
                total = f.constant(F64, 0.0)
                for k, factor in enumerate(factors):
                    total = total + f.load(F32, source.at(j * 12 + 4 * k)).to(F64) * factor
                f.store(maximum(total, 0.0), row.at(j * 8))
        f.give(1)


def add_average(module: Module) -> None:
    """Average the numbers at the corners of each cell; there is one more row and column of corners than of cells."""
    names = [("numbers", PTR), ("target", PTR), ("rows", I64), ("columns", I64)]
    with module.function("average", names, I64) as f:
        numbers, target, rows, columns = f.parameters
        with f.each(0, rows) as i:
            upper, lower = corner_rows(numbers, i, columns, 8)
            with f.each(0, columns) as j:
                a, b, c, d = corners(f, F64, upper, lower, j)
                f.store((a + b + c + d) / 4.0, target.at((i * columns + j) * 8))
        f.give(1)


def add_gather_corners(module: Module) -> None:
    """Put the numbers (single precision) at the corners of each cell side by side."""
    names = [("numbers", PTR), ("target", PTR), ("rows", I64), ("columns", I64)]
    with module.function("gather_corners", names, I64) as f:
        numbers, target, rows, columns = f.parameters
        with f.each(0, rows) as i:
            upper, lower = corner_rows(numbers, i, columns, 4)
            with f.each(0, columns) as j:
                write(f, target, i * columns + j, corners(f, F32, upper, lower, j))
        f.give(1)


def add_halve(module: Module) -> None:
    """Write the nodes over cells in fours, and their masses: see `djpt.distributions.grids.halve`."""
    names = [("mass", PTR), ("nodes", PTR), ("totals", PTR), ("rows", I64), ("columns", I64)]
    with module.function("halve", names, I64) as f:
        mass, nodes, totals, rows, columns = f.parameters
        with f.each(0, rows) as i:
            upper = mass.at(i * columns * 32)
            lower = upper.at(columns * 16)
            with f.each(0, columns) as j:
                a, b, c, d = (f.load(F64, row.at(j * 16 + k)) for row in (upper, lower) for k in (0, 8))
                above, below = a + b, c + d
                total = above + below
                node = i * columns + j
                shares = [share(f, *pair) for pair in ((above, total), (a, above), (c, below))]
                write(f, nodes, node, [*shares, f.constant(F32, 0.0)])
                f.store(total, totals.at(node * 8))
        f.give(1)


def add_join(module: Module) -> None:
    """Put texels (single precision) and numbers side by side; `strides`: bytes from row to row of both."""
    names = [("texels", PTR), ("numbers", PTR), ("target", PTR), ("size", PTR), ("strides", PTR)]
    with module.function("join", names, I64) as f:
        texels, numbers, target, size, strides = f.parameters
        rows, columns = f.load(I64, size), f.load(I64, size.at(8))
        with f.each(0, rows) as i:
            source, row = (array.at(i * f.load(I64, strides.at(8 * k))) for k, array in enumerate((texels, numbers)))
            with f.each(0, columns) as j:
                texel = [f.load(F32, source.at(j * 12 + 4 * k)) for k in range(3)]
                write(f, target, i * columns + j, [*texel, f.load(F64, row.at(j * 8)).to(F32)])
        f.give(1)


def corner_rows(numbers: Value, row: Value, columns: Value, size: int) -> tuple[Value, Value]:
    """The addresses of the numbers above and below a row of cells; `size`: bytes of a number."""
    upper = numbers.at(row * (columns + 1) * size)
    return upper, upper.at((columns + 1) * size)


def corners(f: Function, type: Type, upper: Value, lower: Value, column: Value) -> list[Value]:
    """The numbers at the corners of a cell: upper left, upper right, lower left, lower right."""
    return [f.load(type, row.at(column * type.size + k)) for row in (upper, lower) for k in (0, type.size)]


def share(f: Function, part: Value, whole: Value) -> Value:
    """The ratio; 0 where the whole is."""
    result = f.variable(F32, 0.0)
    with f.when(whole > 0.0):
        result.value = (part / whole).to(F32)
    return result.value


def write(f: Function, table: Value, entry: Value, numbers: Sequence[Value]) -> None:
    """Write an entry of a table."""
    for k, number in enumerate(numbers):
        f.store(number, table.at(entry * ENTRY + 4 * k))


FUNCTIONS = HostFunctions(add_grid_functions, PARAMETERS, small=1 << 12, few=1 << 12)
"""The functions for grids of many cells; NumPy does the rest."""

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
