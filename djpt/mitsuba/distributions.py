"""Distributions given by tables that only scripts ask for: under conditions, and over the cells of a grid.

Those of the renderer are in `djpt.distributions`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt import distributions
from djpt.core.forms import forms
from djpt.core.warp import bilinear_to_square, square_to_bilinear
from djpt.distributions.distributions_1d import invert_line
from djpt.distributions.interpolated_2d import Cell, Interpolated2D, Numbers, Slices, WithParameters, table_of
from djpt.distributions.search import Corners, corners_around, equidistant, first_without, segment_of, within
from djpt.errors import ArgumentError
from djpt.jit.types import Bool, Float, Point2f, TensorXf, UInt32, backend, converting

__all__ = [
    "ConditionalIrregular1D",
    "ConditionalRegular1D",
    "DiscreteDistribution2D",
    "Hierarchical2D0",
    "Hierarchical2D1",
    "Hierarchical2D2",
    "Hierarchical2D3",
]

Point2u = backend.Array2u


def converted(attribute: str, convert: Callable[[Any], Any], doc: str) -> Any:
    """A property that converts what is assigned."""
    return property(
        lambda self: getattr(self, attribute), lambda self, value: setattr(self, attribute, convert(value)), doc=doc
    )


def ends_of(pair: Any) -> Any:
    """The first node and the last, a `drjit.scalar.Array2f`."""
    return dr.scalar.Array2f(*(float(x) for x in pair))


# ---- one number under conditions -------------------------------------------------------------


class Conditional(ABC):
    """A density that is linear between nodes, for each point of a grid of conditions.

    Between the points of the grid the densities are interpolated linearly. Subclasses say where the nodes are.
    """

    @abstractmethod
    def _nodes_of_number(self) -> Float:
        """The nodes of the number."""

    @abstractmethod
    def _nodes_of_conditions(self) -> list[Float]:
        """The nodes of each condition."""

    def __init__(self, pdf: Any, sizes: Sequence[int]) -> None:
        if pdf is None:
            self._pdf = TensorXf()
        elif dr.is_tensor_v(pdf):
            self._pdf = TensorXf(pdf)
        else:
            flat = Float(pdf)
            self._pdf = TensorXf(flat, (*sizes, len(flat) // max(1, math.prod(sizes))))
        self._cdf = Float()
        self._integral = Float()

    pdf = converted("_pdf", TensorXf, "The densities at the nodes: one axis per condition, then the one of the number.")

    @property
    def cdf_array(self) -> Float:
        """The integrals of each density up to each node but the first."""
        self._prepare()
        return self._cdf

    @cdf_array.setter
    def cdf_array(self, value: Any) -> None:
        self._cdf = Float(value)

    @property
    def integral_array(self) -> Float:
        """The integral of each density."""
        self._prepare()
        return self._integral

    @integral_array.setter
    def integral_array(self, value: Any) -> None:
        self._integral = Float(value)

    def empty(self) -> bool:
        """Whether there is no table."""
        return len(self._pdf.array) == 0

    def max(self) -> float:
        """The largest entry of the table."""
        return float(dr.max(dr.detach(self._pdf.array))[0])

    def update(self) -> None:
        """Integrate the densities again after an edit."""
        if self.empty():
            return
        count = self._pdf.shape[-1]
        nodes = self._nodes_of_number()
        shape = (*(len(axis) for axis in self._nodes_of_conditions()), len(nodes))
        if count < 2 or tuple(self._pdf.shape) != shape:
            raise ArgumentError(
                f"{type(self).__name__}: 'pdf' must have the shape {shape}, at least two at the end; "
                f"found {tuple(self._pdf.shape)}"
            )
        table = self._pdf.array
        if not dr.all(dr.detach(table) >= 0):
            raise ArgumentError(f"{type(self).__name__}: entries must be non-negative!")
        if not dr.any(dr.detach(table) > 0):
            raise ArgumentError(f"{type(self).__name__}: no probability mass found!")
        slices = len(table) // count
        node = dr.tile(dr.arange(UInt32, count - 1), slices)
        place = node + dr.repeat(dr.arange(UInt32, slices), count - 1) * count
        y0, y1 = dr.gather(Float, table, place), dr.gather(Float, table, place + 1)
        widths = dr.gather(Float, nodes, node + 1) - dr.gather(Float, nodes, node)
        self._cdf = dr.block_prefix_sum(0.5 * widths * (y0 + y1), count - 1, exclusive=False)
        self._integral = dr.gather(Float, self._cdf, dr.arange(UInt32, slices) * (count - 1) + (count - 2))

    def _prepare(self) -> None:
        if len(self._cdf) == 0:
            self.update()

    def _corners(self, cond: Sequence[Any], active: Bool | bool) -> Corners:
        """The points of the grid around some conditions."""
        axes = self._nodes_of_conditions()
        if len(cond) != len(axes):
            raise ArgumentError(f"{type(self).__name__}: {len(axes)} conditions are needed, found {len(cond)}")
        return corners_around(axes, [Float(value) for value in cond], active)

    def _mean(self, table: Float, corners: Corners, stride: int, offset: Any, active: Bool | bool) -> Float:
        """The weighted sum of entries of the densities at some corners."""
        total = Float(0)
        for corner, weight in corners:
            value = dr.gather(Float, table, corner * stride + offset, (weight > 0) & active)
            total = total + weight * value
        return total

    def eval_pdf(self, x: Any, cond: Sequence[Any], active: Bool | bool = True) -> Float:
        """The density as it was given at `x`, under conditions; 0 outside of any range."""
        x, nodes = Float(x), self._nodes_of_number()
        corners = self._corners(cond, active)
        inside = within(nodes, x)
        for axis, value in zip(self._nodes_of_conditions(), cond, strict=True):
            inside &= within(axis, Float(value)) | (len(axis) == 1)
        active = inside & active
        count = len(nodes)
        index = segment_of(nodes, x, active)
        x0, x1 = (dr.gather(Float, nodes, index + k, active) for k in (0, 1))
        y0, y1 = (self._mean(self._pdf.array, corners, count, index + k, active) for k in (0, 1))
        return dr.select(active, dr.fma((x - x0) / (x1 - x0), y1 - y0, y0), 0)

    def eval_pdf_normalized(self, x: Any, cond: Sequence[Any], active: Bool | bool = True) -> Float:
        """The density at `x` under conditions, with the integral 1."""
        value = self.eval_pdf(x, cond, active)
        return dr.select(value > 0, value / self.integral(cond), 0)

    def integral(self, cond: Sequence[Any]) -> Float:
        """The integral of the density under conditions, as it was given."""
        self._prepare()
        return self._mean(self._integral, self._corners(cond, True), 1, 0, True)

    def sample_pdf(self, u: Any, cond: Sequence[Any], active: Bool | bool = True) -> tuple[Float, Float]:
        """A number under conditions, by a uniform number in [0, 1], and its normalised density."""
        self._prepare()
        nodes = self._nodes_of_number()
        count = len(nodes)
        corners = self._corners(cond, active)
        total = self._mean(self._integral, corners, 1, 0, active)
        wanted = Float(u) * total

        def sum_to(index: UInt32, active: Bool | bool) -> Float:
            return self._mean(self._cdf, corners, count - 1, index, active)

        index = first_without(0, count - 2, lambda i: sum_to(i, active) < wanted)
        x0, x1 = (dr.gather(Float, nodes, index + k, active) for k in (0, 1))
        y0, y1 = (self._mean(self._pdf.array, corners, count, index + k, active) for k in (0, 1))
        before = sum_to(index - 1, (index > 0) & active)
        t = invert_line((wanted - before) / (x1 - x0), y0, y1)
        return dr.fma(t, x1 - x0, x0), dr.fma(t, y1 - y0, y0) / total

    def __repr__(self) -> str:
        return f"{type(self).__name__}[\n  shape = {tuple(self._pdf.shape)}\n]"


class ConditionalIrregular1D(Conditional):
    """A density with nodes of any distances, under conditions whose nodes have any distances.

    Args:
        nodes: of the number, in increasing order.
        pdf: densities at the nodes, one axis per condition, then the one of the number; a tensor, or flat.
        nodes_cond: the nodes of each condition.
    """

    @forms("nodes pdf nodes_cond", "|")
    def __init__(self, *, nodes: Any = None, pdf: Any = None, nodes_cond: Sequence[Any] = ()) -> None:
        self.nodes = Float() if nodes is None else nodes
        self.nodes_cond = nodes_cond
        super().__init__(pdf, [len(axis) for axis in self._nodes_cond])

    _nodes: Float
    _nodes_cond: list[Float]
    nodes = converted("_nodes", Float, "The nodes of the number.")

    nodes_cond = converted("_nodes_cond", lambda axes: [Float(nodes) for nodes in axes], "The nodes of each condition.")

    def _nodes_of_number(self) -> Float:
        return self._nodes

    def _nodes_of_conditions(self) -> list[Float]:
        return self._nodes_cond


class ConditionalRegular1D(Conditional):
    """A density with equidistant nodes, under conditions whose nodes are equidistant.

    Args:
        pdf: densities at the nodes, one axis per condition, then the one of the number; a tensor, or flat.
        range: the first node and the last.
        range_cond: the same for each condition.
        size_cond: the number of nodes of each condition, for a flat table.
    """

    @forms("pdf range range_cond | size_cond", "|")
    def __init__(
        self, *, pdf: Any = None, range: Any = (0, 0), range_cond: Sequence[Any] = (), size_cond: Sequence[int] = ()
    ) -> None:
        self.range = range
        self.range_cond = range_cond
        super().__init__(pdf, size_cond)

    _range: Any
    _range_cond: list[Any]
    range = converted("_range", ends_of, "The first node and the last, a `drjit.scalar.Array2f`.")

    range_cond = converted(
        "_range_cond", lambda pairs: [ends_of(pair) for pair in pairs], "The first node and the last of each condition."
    )

    def _nodes_of_number(self) -> Float:
        return equidistant(self._range, self._pdf.shape[-1])

    def _nodes_of_conditions(self) -> list[Float]:
        return [equidistant(ends, count) for ends, count in zip(self._range_cond, self._pdf.shape[:-1], strict=False)]


# ---- cells of a grid -------------------------------------------------------------------------


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
