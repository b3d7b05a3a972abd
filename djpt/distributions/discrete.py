"""Choices by weights: among a few fixed numbers, among many in memory, and among the cells of a grid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.lookup import Rows
from djpt.description.plugin import HIDDEN, ParamFlags, Plugin, TraversalCallback
from djpt.dispatch.tables import entry_at
from djpt.jit.kernels import aligned_floats, as_float, maximum
from djpt.jit.types import Bool, Float, Point2f, TensorXf, UInt32

__all__ = ["Discrete", "DiscreteDistribution2D", "Weights"]


class Discrete:
    """A distribution that gives the number i the probability w_i / sum w; sampled by inverting the cumulative sums."""

    def __init__(self, weights: NDArray[np.float64]) -> None:
        """Build the tables; `weights` are finite, not negative, and not all 0."""
        chances = weights / weights.sum()
        ends = np.cumsum(chances)
        # Rounding must not lead to a weight of 0 at the end.
        ends[np.nonzero(weights)[0][-1] :] = 1.0
        self._last = len(weights) - 1
        self._chances = Rows([as_float(x) for x in chances])
        self._begins = Rows([as_float(x) for x in np.concatenate([[0.0], ends[:-1]])])

    def choose(self, u: Float) -> tuple[UInt32, Float, Float]:
        """Choose a number by the uniform number `u`.

        Returns:
            The number, the inverse of its probability (0 if rounding led to a weight of 0), a fresh uniform number.
        """
        # The last one that begins at or before `u` and has a chance: equal beginnings are empty ones.
        index = UInt32(dr.binary_search(0, self._last, lambda i: self._begins.at(UInt32(i + 1)) <= u))
        inverse = dr.rcp(self._chances.at(index))
        left = (u - self._begins.at(index)) * inverse
        return index, dr.select(dr.isfinite(inverse), inverse, 0), dr.clip(left, 0, 1 - 2**-24)

    def probability(self, index: UInt32) -> Float:
        """The probability of the number `index`; unspecified beyond the last."""
        return self._chances.at(index)


class Weights:
    """Numbers i with the probability w_i / sum w, chosen by inverting running sums; how many is no part of kernels."""

    def __init__(self, weights: Float) -> None:
        """Compute the sums; `weights` aren't negative. If all are 0, every choice has the probability 0."""
        self._weights = dr.detach(weights)
        self._sums = dr.cumsum(self._weights)
        self._last = len(self._weights) - 1
        total = dr.gather(Float, self._sums, UInt32(self._last))
        self._total, self._inverse = total, dr.select(total > 0, dr.rcp(total), 0)
        dr.eval(self._weights, self._sums, self._total, self._inverse)

    def choose(self, u: Float, active: Bool | bool = True) -> tuple[UInt32, Float, Float]:
        """A number by the uniform number `u`, what is left of `u`, uniform again, and the number's probability."""
        wanted = u * self._total

        def before(index: UInt32) -> Bool:
            end = dr.gather(Float, self._sums, UInt32(index), active)
            return ((end < wanted) | (end == 0)) & (end != self._total)

        index = UInt32(dr.binary_search(0, self._last, before))
        probability = self.probability(index, active)
        left = (u - self.probability_below(index, active)) / probability
        return index, dr.select(probability > 0, left, 0), probability

    def probability(self, index: UInt32, active: Bool | bool = True) -> Float:
        """The probability of a number."""
        return dr.gather(Float, self._weights, index, active) * self._inverse

    def probability_below(self, index: UInt32, active: Bool | bool = True) -> Float:
        """The probability of all smaller numbers."""
        return dr.gather(Float, self._sums, index - 1, (index > 0) & active) * self._inverse


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
