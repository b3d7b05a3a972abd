"""Distributions over the cells of a grid that only scripts ask for.

Those of the renderer are in `djpt.distributions`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from djpt import distributions
from djpt.core.warp import bilinear_to_square, square_to_bilinear
from djpt.distributions.interpolated_2d import Cell, Interpolated2D, Numbers, Slices, WithParameters, table_of
from djpt.errors import ArgumentError
from djpt.jit.types import Bool, Float, Point2f, UInt32, backend, converting

__all__ = [
    "DiscreteDistribution2D",
    "Hierarchical2D0",
    "Hierarchical2D1",
    "Hierarchical2D2",
    "Hierarchical2D3",
]

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


class Hierarchical2D(Interpolated2D):
    """A density that interpolates a grid bilinearly, sampled by a quadtree over its cells.

    Each step decides on an upper or lower half with the sample's second number, then on its left or right half with
    the first one, and stretches what is left (P. Clarberg et al., "Wavelet Importance Sampling", SIGGRAPH 2005).
    With several parameters the sums in the tree are interpolated, too. The renderer's own is
    `djpt.distributions.Hierarchical2D`.
    """

    def _prepare(self, slices: Numbers) -> None:
        mass = (slices[:, :-1, :-1] + slices[:, :-1, 1:] + slices[:, 1:, :-1] + slices[:, 1:, 1:]) / 4
        self._levels: list[tuple[Float, int, int]] = []
        while max(mass.shape[1:]) > 1:
            mass = np.pad(mass, [(0, 0), *((0, size % 2) for size in mass.shape[1:])])
            self._levels.append((table_of(mass), *mass.shape[1:]))
            mass = mass[:, ::2, ::2] + mass[:, ::2, 1::2] + mass[:, 1::2, ::2] + mass[:, 1::2, 1::2]

    def _quarters(self, level: int, column: UInt32, row: UInt32, slices: Slices, active: Bool | bool) -> Cell:
        """The masses of the four children of a node, given by its upper left child."""
        table, height, width = self._levels[level]
        first = row * width + column
        a, b, c, d = (self._mean(table, height * width, first + k, slices, active) for k in (0, 1, width, width + 1))
        return a, b, c, d

    @converting
    def sample(self, sample: Point2f, param: Any = (), active: Bool | bool = True) -> tuple[Point2f, Float]:
        self._check_sampling()
        slices = self._slices(param, active)
        x, y = dr.clip(sample.x, 0, 1), dr.clip(sample.y, 0, 1)
        column, row = UInt32(0), UInt32(0)
        for level in reversed(range(len(self._levels))):
            column, row = column << 1, row << 1
            a, b, c, d = self._quarters(level, column, row, slices, active)
            lower, y = halve(y, a + b, c + d)
            right, x = halve(x, dr.select(lower, c, a), dr.select(lower, d, b))
            row, column = row + dr.select(lower, UInt32(1), 0), column + dr.select(right, UInt32(1), 0)
        corners = self._corners(column, row, slices, active)
        place, density = square_to_bilinear(*corners, Point2f(x, y))
        return self._point(column, row, place), density

    @converting
    def invert(self, sample: Point2f, param: Any = (), active: Bool | bool = True) -> tuple[Point2f, Float]:
        self._check_sampling()
        slices = self._slices(param, active)
        column, row, place = self._cell(sample)
        origin, density = bilinear_to_square(*self._corners(column, row, slices, active), place)
        x, y = origin.x, origin.y
        for level in range(len(self._levels)):
            right, lower = (column & 1) == 1, (row & 1) == 1
            a, b, c, d = self._quarters(level, column & ~UInt32(1), row & ~UInt32(1), slices, active)
            y = join(y, lower, a + b, c + d)
            x = join(x, right, dr.select(lower, c, a), dr.select(lower, d, b))
            column, row = column >> 1, row >> 1
        return Point2f(dr.clip(x, 0, 1), dr.clip(y, 0, 1)), density


def halve(x: Float, first: Float, second: Float) -> tuple[Bool, Float]:
    """Whether a uniform number chooses the second of two masses, and what is left of it."""
    x = x * (first + second)
    beyond = x > first
    chosen = dr.select(beyond, second, first)
    left = dr.select(chosen > 0, dr.select(beyond, x - first, x) / chosen, 0)
    return beyond, dr.clip(left, 0, 1)


def join(x: Float, beyond: Bool, first: Float, second: Float) -> Float:
    """The inverse of `halve`: the uniform number that chooses one of two masses and leaves `x`."""
    total = first + second
    place = dr.select(beyond, dr.fma(x, second, first), x * first)
    return dr.select(total > 0, place / total, 0)


class Hierarchical2D0(Hierarchical2D):
    """A density without parameters."""

    dimension = 0


class Hierarchical2D1(WithParameters, Hierarchical2D):
    """A density with one parameter."""

    dimension = 1


class Hierarchical2D2(WithParameters, Hierarchical2D):
    """A density with two parameters."""

    dimension = 2


class Hierarchical2D3(WithParameters, Hierarchical2D):
    """A density with three parameters."""

    dimension = 3
