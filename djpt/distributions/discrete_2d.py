"""Choosing a cell of a grid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.plugin import HIDDEN, ParamFlags, Plugin, TraversalCallback
from djpt.dispatch.tables import entry_at
from djpt.jit.kernels import aligned_floats, as_float, maximum
from djpt.jit.types import Bool, Float, Point2f, TensorXf, UInt32

__all__ = ["DiscreteDistribution2D"]

LEAST = 2.0**-33
"""Stands for a sample of 0, so that a cell of weight 0 in the corner isn't chosen."""


class DiscreteDistribution2D(Plugin):
    """A distribution over the cells of a grid by their weights: a row is chosen first, then a column of it.

    Args:
        name: for messages.
        weights: (rows, columns), not negative; if all are 0, all count the same.

    A child of the plugin that it serves; nothing of it shows in `traverse`. Both steps invert running sums
    (Pharr, Jakob and Humphreys, "Physically Based Rendering", 4th ed., A.5).
    """

    in_any_frame = True
    kind = "distribution"
    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(("rows", "columns", "total"), HIDDEN)
    tables: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(("marginal", "conditional", "relative"), HIDDEN)
    children = ()
    statics = ("steps",)

    # In kernels a `djpt.dispatch.tables.Table` stands in the place of these tensors.
    marginal: Any
    """Running sums of the rows' weights, (rows,)."""
    conditional: Any
    """Running sums along each row, (rows, columns)."""
    relative: Any
    """The weights over their mean: densities over the unit square."""

    def __init__(self, name: str, weights: NDArray[Any]) -> None:
        self.set_id(name)
        self.steps = (0, 0)
        self.set(weights)

    def traverse(self, callback: TraversalCallback) -> None:
        """Report nothing: there is nothing to edit."""

    def set(self, weights: NDArray[Any]) -> None:
        """Take other weights, also of another shape."""
        weights = np.asarray(weights, np.float64)
        mean = weights.mean()
        relative = weights / mean if mean > 0 else np.ones(weights.shape)
        along = np.cumsum(relative, axis=1)
        marginal = np.cumsum(along[:, -1])
        self.marginal, self.conditional, self.relative = (in_memory(table) for table in (marginal, along, relative))
        rows, columns = weights.shape
        self.rows, self.columns = dr.opaque(UInt32, rows), dr.opaque(UInt32, columns)
        self.total = as_float(float(np.float32(marginal[-1])))
        # Never fewer: an edit to and fro compiles one kernel.
        needed = ((rows - 1).bit_length(), (columns - 1).bit_length())
        self.steps = (max(self.steps[0], needed[0]), max(self.steps[1], needed[1]))

    # ---- in kernels --------------------------------------------------------------------

    def sample(self, sample: Point2f, active: Bool | bool = True) -> tuple[UInt32, UInt32, Point2f]:
        """Choose a cell: its column, its row, and what is left of the sample, uniform in the unit square again."""
        y = maximum(sample.y, Float(LEAST)) * self.total
        row, low, high = search(self.marginal, UInt32(0), self.rows, y, self.steps[0], active)
        y = (y - low) * dr.select(high > low, dr.rcp(high - low), 0)
        first = row * self.columns
        x = maximum(sample.x, Float(LEAST)) * entry_at(self.conditional, first + (self.columns - 1), active)
        column, low, high = search(self.conditional, first, self.columns, x, self.steps[1], active)
        x = (x - low) * dr.select(high > low, dr.rcp(high - low), 0)
        return column, row, Point2f(x, y)

    def density(self, column: UInt32, row: UInt32, active: Bool | bool = True) -> Float:
        """The density in a cell if points are uniform within it, per unit of area: the square has the area 1."""
        return entry_at(self.relative, row * self.columns + column, active)


def search(
    table: Any, first: UInt32, count: UInt32, wanted: Float, steps: int, active: Bool | bool
) -> tuple[UInt32, Float, Float]:
    """The first of `count` running sums that isn't below `wanted`: its number, the sum before it, and itself."""
    below = UInt32(0)
    for k in reversed(range(steps)):
        probe = below + (1 << k)
        inside = (probe < count) & active
        further = inside & (entry_at(table, first + (probe - 1), inside) < wanted)
        below = dr.select(further, probe, below)
    before = below > 0
    low = dr.select(before, entry_at(table, first + below - dr.select(before, UInt32(1), UInt32(0)), active), 0)
    return below, low, entry_at(table, first + below, active)


def in_memory(table: NDArray[np.float64]) -> TensorXf:
    """A table as kernels read it."""
    copy = aligned_floats(table.shape)
    copy[...] = table
    return TensorXf(copy)
