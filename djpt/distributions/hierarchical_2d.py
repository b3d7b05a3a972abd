"""Densities that interpolate a grid of numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, TypeVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.plugin import HIDDEN, ParamFlags, Plugin, TraversalCallback
from djpt.dispatch.tables import entry_at
from djpt.distributions.grids import cell_masses, corner_table, halve
from djpt.distributions.recorded_2d import grid_tables
from djpt.jit.kernels import aligned_floats, as_vector, if_stmt, lerp, maximum, minimum
from djpt.jit.types import Bool, Float, Point2f, TensorXf, UInt32

__all__ = ["Hierarchical2D", "place_in_cell"]

T = TypeVar("T")

LEAST = 2.0**-33
"""Stands for a sample of 0, which would lead into cells of weight 0."""
TINY = 1e-37


class Hierarchical2D(Plugin):
    """A density that interpolates numbers bilinearly, sampled by going down a quadtree over the cells between them.

    Each step decides on an upper or lower half, then on its left or right half, with the sample's two numbers
    (P. Clarberg, W. Jarosz, T. Akenine-Moeller and H. W. Jensen, "Wavelet Importance Sampling: Efficiently
    Evaluating Products of Complex Functions", SIGGRAPH 2005). Stretching what is left of the sample after every
    step is put off to the end: until then it stays what it was, in an interval that shrinks.

    A child of the plugin that it serves; nothing of it shows in `traverse`.
    """

    in_any_frame = True
    kind = "distribution"
    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(("columns", "root"), HIDDEN)
    tables: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(("splits", "corners"), HIDDEN)
    children = ()
    statics = ("levels",)

    # In kernels a `djpt.dispatch.tables.Table` stands in the place of these tensors.
    splits: Any
    """The tree from its root down: per node the shares of the upper half, and of the left half of either, and 0."""
    corners: Any
    """The density at the corners of each cell: upper left, upper right, lower left, lower right."""

    at_corners: NDArray[Any]
    """On the host: the density at the corners of the cells, (rows + 1, columns + 1)."""

    def __init__(self) -> None:
        """Start with the density 1 everywhere; `set` replaces it."""
        self.set(np.ones((2, 2)))

    def traverse(self, callback: TraversalCallback) -> None:
        """Report nothing: there is nothing to edit."""

    def set(self, values: NDArray[Any]) -> None:
        """Take (rows + 1, columns + 1) numbers, at the corners of rows x columns cells; not negative, not all 0."""
        values = np.asarray(values, np.float64)
        mass = cell_masses(values)
        self.at_corners = values / mass.mean()
        self.corners = TensorXf(corner_table(self.at_corners).reshape(-1, 1, 4))
        rows, columns = mass.shape
        self.columns = dr.opaque(UInt32, columns)
        self.levels = ((rows - 1).bit_length(), (columns - 1).bit_length())
        """The numbers of halvings of rows and of columns."""
        full = np.zeros((1 << self.levels[0], 1 << self.levels[1]))
        full[:rows, :columns] = mass
        # From the root down: the first level to be written comes last.
        shapes = [tuple(1 << max(count - 1 - level, 0) for count in self.levels) for level in range(max(self.levels))]
        end = sum(rows * columns for rows, columns in shapes)
        nodes = aligned_floats((max(end, 1), 4))
        for level in shapes:
            count = math.prod(level)
            full = halve(full, nodes[end - count : end].reshape(*level, 4))
            end -= count
        self.splits = TensorXf(nodes.reshape(-1, 1, 4))
        self.root = as_vector(nodes[0, :3].astype(np.float64))

    def set_recorded(self, numbers: Float, rows: int, columns: int) -> Float:
        """Take the numbers at the corners of rows x columns cells in a function that `dr.freeze` records, row by row.

        The number of rows and columns must be what it was. The result is the density at the corners.
        """
        found = grid_tables(numbers, rows, columns, self.levels)
        self.splits, self.corners, self.root = found.splits, found.corners, found.root
        return found.at_corners

    # ---- in kernels --------------------------------------------------------------------

    def sample(self, sample: Point2f, active: Bool | bool = True) -> tuple[UInt32, UInt32, Point2f, Float]:
        """Column and row of a cell, a place in it in [0, 1]^2, and the density there.

        All 0 where `active` is false; packets of lanes that are all inactive skip the work.
        """
        nothing = UInt32(0), UInt32(0), Point2f(0), Float(0)
        return found_where(active, self._sample, sample, nothing)

    def _sample(self, sample: Point2f) -> tuple[UInt32, UInt32, Point2f, Float]:
        column, row, rest = self._descend(sample)
        f = entry_at(self.corners, row * self.columns + column)
        place = place_in_cell(f.x, f.y, f.z, f.w, rest)
        return column, row, place, lerp(lerp(f.x, f.y, place.x), lerp(f.z, f.w, place.x), place.y)

    def sample_cell(self, sample: Point2f, active: Bool | bool = True) -> tuple[UInt32, UInt32, Point2f]:
        """Column and row of a cell, as by `sample`, and what is left of the sample, for `place_in_cell`."""
        return found_where(active, self._descend, sample, (UInt32(0), UInt32(0), Point2f(0)))

    def _descend(self, sample: Point2f) -> tuple[UInt32, UInt32, Point2f]:
        x, y = maximum(sample.x, Float(LEAST)), maximum(sample.y, Float(LEAST))
        # `x` and `y` are uniform in intervals from 0 to these.
        width, height = Float(1), Float(1)
        column, row = UInt32(0), UInt32(0)
        first = 0
        for level in reversed(range(max(self.levels))):
            halvings = tuple(max(count - 1 - level, 0) for count in self.levels)
            if first == 0:
                node: Any = self.root
            else:
                node = entry_at(self.splits, first + ((row << halvings[1]) | column))
            first += 1 << sum(halvings)
            share = node.y
            if level < self.levels[0]:
                lower, y, height = below(y, height, node.x)
                row = (row << 1) | dr.select(lower, UInt32(1), UInt32(0))
                share = dr.select(lower, node.z, node.y)
            if level < self.levels[1]:
                right, x, width = below(x, width, share)
                column = (column << 1) | dr.select(right, UInt32(1), UInt32(0))
        # Rounding may have left `x` and `y` just beyond their ends.
        return column, row, Point2f(minimum(x * dr.rcp(width), Float(1)), minimum(y * dr.rcp(height), Float(1)))

    def density(self, column: UInt32, row: UInt32, place: Point2f, active: Bool | bool = True) -> Float:
        """The density at a place of a cell, per unit of area: all cells together have the area 1."""
        f = entry_at(self.corners, row * self.columns + column, active)
        return lerp(lerp(f.x, f.y, place.x), lerp(f.z, f.w, place.x), place.y)


# ---- in kernels ----------------------------------------------------------------------------


def found_where(active: Bool | bool, search: Callable[[Point2f], T], sample: Point2f, nothing: T) -> T:
    """The result of a search by a sample; `nothing` where `active` is false: packets without any other lane skip it."""
    if active is True:
        return search(sample)
    found: T = if_stmt((sample,), Bool(active), search, lambda sample: nothing, label="quadtree")
    return found


def below(x: Float, width: Float, share: Float) -> tuple[Bool, Float, Float]:
    """Whether `x` lies beyond a fraction of the interval from 0 to `width`, and what is left of `x` and `width`.

    0 < x <= width holds for the rest as well, however this is rounded: parts of share 0 are never chosen.
    """
    split = width * share
    beyond = x > split
    return beyond, dr.select(beyond, x - split, x), dr.select(beyond, width - split, split)


def place_in_cell(f00: Float, f10: Float, f01: Float, f11: Float, sample: Point2f) -> Point2f:
    """A place in a cell with a density proportional to the interpolation of the corners (f10: upper right)."""
    y = linear(f00 + f10, f01 + f11, sample.y)
    return Point2f(linear(lerp(f00, f01, y), lerp(f10, f11, y), sample.x), y)


def linear(a: Float, b: Float, sample: Float) -> Float:
    """A number in [0, 1] with a density that is proportional to the straight line from `a` to `b`."""
    root = dr.sqrt(dr.fma(sample, dr.square(b) - dr.square(a), dr.square(a)))
    return minimum(sample * (a + b) * dr.rcp(maximum(a + root, Float(TINY))), Float(1))
