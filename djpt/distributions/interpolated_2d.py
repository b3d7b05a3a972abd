"""Densities over the unit square that interpolate a grid of numbers, and depend on parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.warp import square_to_bilinear_pdf
from djpt.distributions.search import Corners, corners_around
from djpt.errors import ArgumentError
from djpt.jit.types import Bool, Float, Point2f, UInt32, converting

__all__ = ["Cell", "Interpolated2D", "Numbers", "Slices", "WithParameters", "table_of"]

Numbers = NDArray[np.float64]

Slices = Corners
"""Points of the grid of parameters."""

Cell = tuple[Float, Float, Float, Float]
"""The density at the corners of a cell: (x0, y0), (x1, y0), (x0, y1), (x1, y1)."""


class Interpolated2D:
    """A density over the unit square that interpolates a grid of numbers, in up to three parameters as well.

    Args:
        data: numbers at the corners of cells, (..., rows + 1, columns + 1), with an axis per parameter in front.
        param_values: the values of each parameter that `data` is given for, in increasing order.
        normalize: scale the density to the integral 1, for each combination of parameters.
        enable_sampling: prepare `sample` and `invert`; otherwise only `eval` can be called.
    """

    dimension: ClassVar[int]
    """The number of parameters."""

    def __init__(
        self,
        data: Any,
        param_values: Sequence[Sequence[float]] = (),
        normalize: bool = True,
        enable_sampling: bool = True,
    ) -> None:
        values = np.asarray(data, np.float64)
        self._name = type(self).__name__
        if values.ndim != self.dimension + 2 or min(values.shape[-2:], default=0) < 2:
            raise ArgumentError(
                f"{self._name}: 'data' must have {self.dimension + 2} axes, the last two with at least two entries; "
                f"found the shape {values.shape}"
            )
        lengths = tuple(len(axis) for axis in param_values)
        if lengths != values.shape[:-2]:
            raise ArgumentError(f"{self._name}: 'param_values' has {lengths} entries, 'data' {values.shape[:-2]}")
        self._parameters = [Float(np.asarray(axis, np.float32).copy()) for axis in param_values]
        self._rows, self._columns = values.shape[-2] - 1, values.shape[-1] - 1
        slices = values.reshape(-1, *values.shape[-2:])
        if normalize:
            slices = slices / integrals(slices)[:, None, None]
        self._table = table_of(slices)
        self._enabled = enable_sampling
        if enable_sampling:
            self._prepare(slices)

    def _prepare(self, slices: Numbers) -> None:
        """Make the tables for sampling from the densities (slices, rows + 1, columns + 1)."""
        raise NotImplementedError

    def _slices(self, param: Any, active: Bool | bool) -> Slices:
        """The points of the grid of parameters around some parameters, with weights that add up to 1."""
        given = [Float(value) for value in param]
        # Parameters that are left out are 0.
        given += [Float(0)] * (self.dimension - len(given))
        return corners_around(self._parameters, given, active)

    def _mean(self, table: Float, size: int, index: Any, slices: Slices, active: Bool | bool) -> Float:
        """Entry `index` of tables of a size, one per slice, interpolated between slices."""
        parts = [weight * dr.gather(Float, table, slice * size + index, active) for slice, weight in slices]
        return sum(parts[1:], parts[0])

    def _corners(self, column: UInt32, row: UInt32, slices: Slices, active: Bool | bool) -> Cell:
        """The density at the corners of a cell."""
        width = self._columns + 1
        first, size = row * width + column, width * (self._rows + 1)
        a, b, c, d = (self._mean(self._table, size, first + k, slices, active) for k in (0, 1, width, width + 1))
        return a, b, c, d

    def _cell(self, pos: Point2f) -> tuple[UInt32, UInt32, Point2f]:
        """Column and row of the cell that a point lies in, and the place in the cell."""
        x, y = dr.clip(pos.x, 0, 1) * self._columns, dr.clip(pos.y, 0, 1) * self._rows
        column = UInt32(dr.minimum(x, self._columns - 1))
        row = UInt32(dr.minimum(y, self._rows - 1))
        return column, row, Point2f(x - Float(column), y - Float(row))

    def _point(self, column: UInt32, row: UInt32, place: Point2f) -> Point2f:
        """The point at a place in a cell."""
        return Point2f((Float(column) + place.x) / self._columns, (Float(row) + place.y) / self._rows)

    def _check_sampling(self) -> None:
        if not self._enabled:
            raise ArgumentError(f"{self._name}: made with enable_sampling=False, so there is nothing to sample by")

    @converting
    def eval(self, pos: Point2f, param: Any = (), active: Bool | bool = True) -> Float:
        """The density at a point of the unit square, under parameters."""
        column, row, place = self._cell(pos)
        return square_to_bilinear_pdf(*self._corners(column, row, self._slices(param, active), active), place)

    def sample(self, sample: Point2f, param: Any = (), active: Bool | bool = True) -> tuple[Point2f, Float]:
        """A point of the unit square under parameters, and the density there."""
        raise NotImplementedError

    def invert(self, sample: Point2f, param: Any = (), active: Bool | bool = True) -> tuple[Point2f, Float]:
        """The sample that leads to a point, and the density at the point."""
        raise NotImplementedError

    def __repr__(self) -> str:
        shape = "".join(f"{len(axis)} x " for axis in self._parameters)
        return f"{self._name}[\n  size = [{self._columns + 1}, {self._rows + 1}],\n  slices = {shape}1\n]"


class WithParameters(Interpolated2D):
    """The base of densities with parameters, which must be given; `build_hierarchy` prepares sampling.

    To be derived from before the kind of density.
    """

    def __init__(
        self, data: Any, param_values: Sequence[Sequence[float]], normalize: bool = True, build_hierarchy: bool = True
    ) -> None:
        super().__init__(data, param_values, normalize, build_hierarchy)


def integrals(slices: Numbers) -> Numbers:
    """The integral of each density over the unit square."""
    cells = slices[:, :-1, :-1] + slices[:, :-1, 1:] + slices[:, 1:, :-1] + slices[:, 1:, 1:]
    mean: Numbers = cells.mean(axis=(1, 2)) / 4
    if not (mean > 0).all():
        raise ArgumentError("a density must have a positive integral")
    return mean


def table_of(numbers: Numbers) -> Float:
    """Numbers as kernels read them."""
    return Float(np.ascontiguousarray(numbers, np.float32).ravel().copy())
