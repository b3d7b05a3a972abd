"""Densities over the unit square that are sampled by a marginal density of y and conditional ones of x."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.warp import bilinear_to_square, square_to_bilinear
from djpt.distributions.interpolated_2d import Interpolated2D, Numbers, Slices, WithParameters, table_of
from djpt.distributions.search import first_without
from djpt.jit.types import Bool, Float, Point2f, UInt32, converting

__all__ = [
    "MarginalContinuous2D0",
    "MarginalContinuous2D1",
    "MarginalContinuous2D2",
    "MarginalContinuous2D3",
    "MarginalDiscrete2D0",
    "MarginalDiscrete2D1",
    "MarginalDiscrete2D2",
    "MarginalDiscrete2D3",
]

LEAST, MOST = 2.0**-24, 1 - 2.0**-24
"""Samples are kept away from 0 and 1, where they could lead to cells without mass."""

Sums = Callable[[UInt32, Any], Float]
"""Running sums: entry `index`, where the mask is set, else 0."""


class Marginal2D(Interpolated2D):
    """The base of both kinds: running sums over the rows, and along rows."""

    def _prepare(self, slices: Numbers) -> None:
        along = self._along(slices)
        self._conditional_rows = along.shape[1]
        self._conditional = table_of(along)
        self._marginal = table_of(np.cumsum(self._of_rows(along[:, :, -1]), axis=1))

    def _along(self, slices: Numbers) -> Numbers:
        """Running integrals along rows, (slices, rows, columns)."""
        raise NotImplementedError

    def _of_rows(self, totals: Numbers) -> Numbers:
        """The masses of rows of cells."""
        raise NotImplementedError

    def _rows_sums(self, slices: Slices) -> Sums:
        return lambda index, mask: self._mean(self._marginal, self._rows, index, slices, mask)

    def _row_sums(self, row: UInt32, slices: Slices) -> Sums:
        """The running integrals of one row."""
        size = self._conditional_rows * self._columns
        first = row * self._columns
        return lambda index, mask: self._mean(self._conditional, size, first + index, slices, mask)

    def _choose(self, sums: Sums, count: int, wanted: Float, active: Bool | bool) -> tuple[UInt32, Float, Float]:
        """The first entry of running sums that isn't below `wanted`; the sum before it, and itself."""
        index = first_without(0, count - 1, lambda i: sums(i, active) < wanted)
        return index, sums(index - 1, (index > 0) & active), sums(index, active)


class MarginalDiscrete2D(Marginal2D):
    """A density that interpolates a grid bilinearly: a cell is chosen by its mass, then a place in the cell."""

    def _along(self, slices: Numbers) -> Numbers:
        cells = slices[:, :-1, :-1] + slices[:, :-1, 1:] + slices[:, 1:, :-1] + slices[:, 1:, 1:]
        sums: Numbers = np.cumsum(cells / (4 * self._rows * self._columns), axis=2)
        return sums

    def _of_rows(self, totals: Numbers) -> Numbers:
        return totals

    @converting
    def sample(self, sample: Point2f, param: Any = (), active: Bool | bool = True) -> tuple[Point2f, Float]:
        self._check_sampling()
        slices = self._slices(param, active)
        rows = self._rows_sums(slices)
        y = dr.clip(sample.y, LEAST, MOST) * rows(UInt32(self._rows - 1), active)
        row, low, high = self._choose(rows, self._rows, y, active)
        y = share(y, low, high)
        columns = self._row_sums(row, slices)
        x = dr.clip(sample.x, LEAST, MOST) * columns(UInt32(self._columns - 1), active)
        column, low, high = self._choose(columns, self._columns, x, active)
        x = share(x, low, high)
        place, density = square_to_bilinear(*self._corners(column, row, slices, active), Point2f(x, y))
        return self._point(column, row, place), density

    @converting
    def invert(self, sample: Point2f, param: Any = (), active: Bool | bool = True) -> tuple[Point2f, Float]:
        self._check_sampling()
        slices = self._slices(param, active)
        column, row, place = self._cell(sample)
        origin, density = bilinear_to_square(*self._corners(column, row, slices, active), place)
        rows, columns = self._rows_sums(slices), self._row_sums(row, slices)
        y = dr.lerp(rows(row - 1, (row > 0) & active), rows(row, active), origin.y)
        x = dr.lerp(columns(column - 1, (column > 0) & active), columns(column, active), origin.x)
        ends = columns(UInt32(self._columns - 1), active), rows(UInt32(self._rows - 1), active)
        return Point2f(x / ends[0], y / ends[1]), density


class MarginalContinuous2D(Marginal2D):
    """A density that interpolates a grid bilinearly: y by the integrals along rows of nodes, then x at that y.

    Both are inverted in the densities themselves, which are linear between nodes, so that neighbouring samples always
    lead to neighbouring points.
    """

    def _along(self, slices: Numbers) -> Numbers:
        sums: Numbers = np.cumsum((slices[:, :, :-1] + slices[:, :, 1:]) / (2 * self._columns), axis=2)
        return sums

    def _of_rows(self, totals: Numbers) -> Numbers:
        masses: Numbers = (totals[:, :-1] + totals[:, 1:]) / (2 * self._rows)
        return masses

    def _between(self, row: UInt32, y: Float, slices: Slices) -> Sums:
        """The running integrals along a line between two rows of nodes."""
        upper, lower = self._row_sums(row, slices), self._row_sums(row + 1, slices)
        return lambda index, mask: dr.lerp(upper(index, mask), lower(index, mask), y)

    @converting
    def sample(self, sample: Point2f, param: Any = (), active: Bool | bool = True) -> tuple[Point2f, Float]:
        self._check_sampling()
        slices = self._slices(param, active)
        last = UInt32(self._columns - 1)
        rows = self._rows_sums(slices)
        y = dr.clip(sample.y, LEAST, MOST) * rows(UInt32(self._rows - 1), active)
        row, low, _ = self._choose(rows, self._rows, y, active)
        ends = self._row_sums(row, slices)(last, active), self._row_sums(row + 1, slices)(last, active)
        y = place_in_segment((y - low) * self._rows, *ends)
        columns = self._between(row, y, slices)
        x = dr.clip(sample.x, LEAST, MOST) * columns(last, active)
        column, low, _ = self._choose(columns, self._columns, x, active)
        a, b, c, d = self._corners(column, row, slices, active)
        left, right = dr.lerp(a, c, y), dr.lerp(b, d, y)
        x = place_in_segment((x - low) * self._columns, left, right)
        return self._point(column, row, Point2f(x, y)), dr.lerp(left, right, x)

    @converting
    def invert(self, sample: Point2f, param: Any = (), active: Bool | bool = True) -> tuple[Point2f, Float]:
        self._check_sampling()
        slices = self._slices(param, active)
        last = UInt32(self._columns - 1)
        column, row, place = self._cell(sample)
        a, b, c, d = self._corners(column, row, slices, active)
        left, right = dr.lerp(a, c, place.y), dr.lerp(b, d, place.y)
        columns, rows = self._between(row, place.y, slices), self._rows_sums(slices)
        x = columns(column - 1, (column > 0) & active) + segment_to(place.x, left, right) / self._columns
        ends = self._row_sums(row, slices)(last, active), self._row_sums(row + 1, slices)(last, active)
        y = rows(row - 1, (row > 0) & active) + segment_to(place.y, *ends) / self._rows
        origin = Point2f(x / columns(last, active), y / rows(UInt32(self._rows - 1), active))
        return origin, dr.lerp(left, right, place.x)


def share(x: Float, low: Float, high: Float) -> Float:
    """The relative place of a number in an interval; its distance from the start if the interval is empty."""
    return dr.select(high != low, (x - low) / (high - low), x - low)


def place_in_segment(area: Float, v0: Float, v1: Float) -> Float:
    """The t in [0, 1] at which the integral of the line from `v0` (t = 0) to `v1` (t = 1) is `area`."""
    sloped = dr.abs(v0 - v1) > 1e-4 * (v0 + v1)
    divisor = dr.select(sloped, v0 - v1, v0 + v1)
    root = dr.safe_sqrt(dr.square(v0) + 2 * area * (v1 - v0))
    return dr.select(divisor != 0, dr.select(sloped, v0 - root, 2 * area) / divisor, 2 * area)


def segment_to(t: Float, v0: Float, v1: Float) -> Float:
    """The inverse of `place_in_segment`."""
    return t * dr.lerp(v0, v1, 0.5 * t)


class MarginalDiscrete2D0(MarginalDiscrete2D):
    """A density without parameters."""

    dimension = 0


class MarginalDiscrete2D1(WithParameters, MarginalDiscrete2D):
    """A density with one parameter."""

    dimension = 1


class MarginalDiscrete2D2(WithParameters, MarginalDiscrete2D):
    """A density with two parameters."""

    dimension = 2


class MarginalDiscrete2D3(WithParameters, MarginalDiscrete2D):
    """A density with three parameters."""

    dimension = 3


class MarginalContinuous2D0(MarginalContinuous2D):
    """A density without parameters."""

    dimension = 0


class MarginalContinuous2D1(WithParameters, MarginalContinuous2D):
    """A density with one parameter."""

    dimension = 1


class MarginalContinuous2D2(WithParameters, MarginalContinuous2D):
    """A density with two parameters."""

    dimension = 2


class MarginalContinuous2D3(WithParameters, MarginalContinuous2D):
    """A density with three parameters."""

    dimension = 3
