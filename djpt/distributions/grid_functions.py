"""Tables over grids of numbers as functions in LLVM's language; NumPy does the same in `djpt.distributions.grids`.

Numbers have double precision and tables single precision, unless noted; grids lie in memory row by row, and an entry
of a table is four floats.
"""

from __future__ import annotations

from collections.abc import Sequence

from djpt.jit.llvm.arithmetic import maximum
from djpt.jit.llvm.ir import F32, F64, I64, PTR, Function, Module, Type, Value

__all__ = ["PARAMETERS", "add_grid_functions"]

PARAMETERS = {"weigh": 5, "average": 4, "gather_corners": 4, "halve": 5, "join": 5}
"""The functions, and how many parameters each has."""

ENTRY = 16
"""Bytes of an entry of a table."""


def add_grid_functions(module: Module) -> None:
    """Add the functions to a module."""
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
