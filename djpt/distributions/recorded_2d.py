"""The tables of `Hierarchical2D` computed by kernels, for grids that change in functions which `dr.freeze` records."""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr

from djpt.jit.types import Array4f, Float, TensorXf, UInt32, Vector3f

__all__ = ["GridTables", "grid_tables"]


class GridTables(NamedTuple):
    """What kernels read of a grid of cells, see `Hierarchical2D`, and the density at the corners of cells."""

    splits: TensorXf
    corners: TensorXf
    root: Vector3f
    at_corners: Float
    """Row by row, (rows + 1) x (columns + 1)."""


def grid_tables(numbers: Float, rows: int, columns: int, levels: tuple[int, int]) -> GridTables:
    """The tables of numbers at the corners of cells.

    Args:
        numbers: Not negative and not all 0, row by row, (rows + 1) x (columns + 1).
        rows: Those of cells.
        columns: Those of cells.
        levels: How often rows and columns are halved until one cell is left.
    """
    cell = dr.arange(UInt32, rows * columns)
    upper_left = cell // columns * (columns + 1) + cell % columns
    offsets = (0, 1, columns + 1, columns + 2)
    mass = sum(dr.gather(Float, numbers, upper_left + k) for k in offsets) / 4
    dr.eval(mass)
    at_corners = numbers * (rows * columns * dr.rcp(dr.sum(mass)))
    dr.eval(at_corners)

    entry = dr.arange(UInt32, 4 * rows * columns)
    cell, corner = entry // 4, entry % 4
    upper_left = cell // columns * (columns + 1) + cell % columns
    corners = dr.gather(Float, at_corners, upper_left + corner // 2 * (columns + 1) + corner % 2)

    parts = list[Float]()
    for level in range(max(levels)):
        # The cells of this level, of which powers of two are halved; those beyond the grid have no mass.
        height, width = (1 << max(count - 1 - level, 0) for count in levels)
        node = dr.arange(UInt32, height * width)
        down, across = (int(level < count) for count in levels)
        top, left = node // width << down, node % width << across

        a, b, c, d = (
            dr.gather(Float, mass, row * columns + column, (row < rows) & (column < columns))
            for row in (top, top + down)
            for column in (left, left + across)
        )
        # Where there is nothing to halve, all is above or to the left.
        b, d = (b, d) if across else (Float(0), Float(0))
        c, d = (c, d) if down else (Float(0), Float(0))
        above, below = a + b, c + d
        nodes: Any = Array4f(share(above, above + below), share(a, above), share(c, below), 0)
        mass, rows, columns = above + below, height, width
        parts.insert(0, Float(dr.ravel(nodes)))
        dr.eval(mass, parts[0])
    splits = dr.concat(parts) if parts else dr.zeros(Float, 4)
    root = Vector3f(*(dr.gather(Float, splits, UInt32(k)) for k in range(3)))
    dr.eval(splits, corners, root)
    first, second = (TensorXf(table, (dr.width(table) // 4, 1, 4)) for table in (splits, corners))
    return GridTables(first, second, root, at_corners)


def share(part: Float, whole: Float) -> Float:
    """The ratio; 0 where the whole is."""
    return dr.select(whole > 0, part / whole, 0)
