"""Cells of a grid by their weights."""

from __future__ import annotations

from typing import Any

import numpy as np

from djpt import distributions
from djpt.errors import ArgumentError
from djpt.jit.types import Bool, Float, Point2f, backend, converting

__all__ = ["DiscreteDistribution2D"]

Point2u = backend.Array2u


class DiscreteDistribution2D:
    """Cells of a grid by their weights: a row is chosen first, then a column of it.

    Args:
        data: weights, (rows, columns), not negative.

    The renderer's own is `djpt.distributions.DiscreteDistribution2D`.
    """

    def __init__(self, data: Any) -> None:
        weights = np.asarray(data, np.float64)
        if weights.ndim != 2:
            raise ArgumentError(f"DiscreteDistribution2D: 'data' must have two axes, found {weights.ndim}")
        self._size = weights.shape[1], weights.shape[0]
        self._sum = float(weights.sum())
        self._cells = distributions.DiscreteDistribution2D("distribution", weights)

    def eval(self, pos: Any, active: Bool | bool = True) -> Float:
        """The weight of the cell (column, row)."""
        return self.pdf(pos, active) * self._sum

    def pdf(self, pos: Any, active: Bool | bool = True) -> Float:
        """The probability of the cell (column, row)."""
        cell = Point2u(pos)
        return self._cells.density(cell.x, cell.y, active) / (self._size[0] * self._size[1])

    @converting
    def sample(self, sample: Point2f, active: Bool | bool = True) -> tuple[Any, Float, Point2f]:
        """A cell (column, row), its probability, and what is left of the sample, uniform in the unit square again."""
        column, row, rest = self._cells.sample(sample, active)
        cell = Point2u(column, row)
        return cell, self.pdf(cell, active), rest

    def __repr__(self) -> str:
        return f"DiscreteDistribution2D[\n  size = [{self._size[0]}, {self._size[1]}],\n  sum = {self._sum}\n]"
