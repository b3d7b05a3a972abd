"""Distributions of one number that depend on other numbers, given by tables.

A table holds a density that is linear between nodes for each point of a grid of conditions. Between the points of
the grid the densities are interpolated linearly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr

from djpt.core.forms import forms
from djpt.distributions.distributions_1d import invert_line
from djpt.distributions.search import first_without
from djpt.errors import ArgumentError
from djpt.jit.types import Bool, Float, TensorXf, UInt32

__all__ = ["ConditionalIrregular1D", "ConditionalRegular1D"]

Corners = list[tuple[UInt32, Float]]
"""Points of the grid of conditions, with their weights."""


class Conditional:
    """What both distributions have: nodes of the number and of each condition are found by subclasses."""

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

    # ---- tables ------------------------------------------------------------------------------

    @property
    def pdf(self) -> TensorXf:
        """The densities at the nodes: one axis per condition, then the one of the number."""
        return self._pdf

    @pdf.setter
    def pdf(self, value: Any) -> None:
        self._pdf = TensorXf(value)

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
        shape = (*self._sizes(), self._count())
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
        areas = 0.5 * (self._node(node + 1) - self._node(node)) * (y0 + y1)
        self._cdf = dr.block_prefix_sum(areas, count - 1, exclusive=False)
        self._integral = dr.gather(Float, self._cdf, dr.arange(UInt32, slices) * (count - 1) + (count - 2))

    def _prepare(self) -> None:
        if len(self._cdf) == 0:
            self.update()

    # ---- grids -------------------------------------------------------------------------------

    def _count(self) -> int:
        """The number of nodes."""
        raise NotImplementedError

    def _sizes(self) -> tuple[int, ...]:
        """The number of nodes of each condition."""
        raise NotImplementedError

    def _node(self, index: UInt32, active: Bool | bool = True) -> Float:
        """Node number `index`."""
        raise NotImplementedError

    def _find(self, x: Float, active: Bool | bool) -> tuple[UInt32, Bool]:
        """The segment that a number lies in, or the nearest one, and whether it is inside of the range."""
        raise NotImplementedError

    def _condition(self, axis: int, x: Float, active: Bool | bool) -> tuple[UInt32, Float, Bool]:
        """The node of a condition below `x`, the weight of the next one, and whether `x` is inside of the range."""
        raise NotImplementedError

    def _corners(self, cond: Sequence[Any], active: Bool | bool) -> tuple[Corners, Bool]:
        """The points of the grid around some conditions, and whether these are inside of the grid."""
        sizes = self._sizes()
        if len(cond) != len(sizes):
            raise ArgumentError(f"{type(self).__name__}: {len(sizes)} conditions are needed, found {len(cond)}")
        corners: Corners = [(UInt32(0), Float(1))]
        inside = Bool(True)
        for axis, (size, value) in enumerate(zip(sizes, cond, strict=True)):
            if size == 1:
                continue
            index, share, within = self._condition(axis, Float(value), active)
            corners = [
                (corner * size + index + k, weight * (share if k else 1 - share))
                for corner, weight in corners
                for k in (0, 1)
            ]
            inside = inside & within
        return corners, inside

    def _mean(self, table: Float, corners: Corners, stride: int, offset: Any, active: Bool | bool) -> Float:
        """The weighted sum of entries of the densities at some corners."""
        total = Float(0)
        for corner, weight in corners:
            value = dr.gather(Float, table, corner * stride + offset, (weight > 0) & active)
            total = total + weight * value
        return total

    # ---- queries -----------------------------------------------------------------------------

    def eval_pdf(self, x: Any, cond: Sequence[Any], active: Bool | bool = True) -> Float:
        """The density as it was given at `x`, under conditions; 0 outside of any range."""
        x = Float(x)
        corners, inside = self._corners(cond, active)
        index, within = self._find(x, active)
        active = inside & within & active
        x0 = self._node(index, active)
        t = (x - x0) / (self._node(index + 1, active) - x0)
        count = self._count()
        y0, y1 = (self._mean(self._pdf.array, corners, count, index + k, active) for k in (0, 1))
        return dr.select(active, dr.fma(t, y1 - y0, y0), 0)

    def eval_pdf_normalized(self, x: Any, cond: Sequence[Any], active: Bool | bool = True) -> Float:
        """The density at `x` under conditions, with the integral 1."""
        value = self.eval_pdf(x, cond, active)
        return dr.select(value > 0, value / self.integral(cond), 0)

    def integral(self, cond: Sequence[Any]) -> Float:
        """The integral of the density under conditions, as it was given."""
        self._prepare()
        corners, _ = self._corners(cond, True)
        return self._mean(self._integral, corners, 1, 0, True)

    def sample_pdf(self, u: Any, cond: Sequence[Any], active: Bool | bool = True) -> tuple[Float, Float]:
        """A number under conditions, by a uniform number in [0, 1], and its normalised density."""
        self._prepare()
        count = self._count()
        corners, _ = self._corners(cond, active)
        total = self._mean(self._integral, corners, 1, 0, active)
        wanted = Float(u) * total

        def sum_to(index: UInt32, active: Bool | bool) -> Float:
            return self._mean(self._cdf, corners, count - 1, index, active)

        index = first_without(0, count - 2, lambda i: sum_to(i, active) < wanted)
        x0 = self._node(index, active)
        width = self._node(index + 1, active) - x0
        y0, y1 = (self._mean(self._pdf.array, corners, count, index + k, active) for k in (0, 1))
        before = sum_to(index - 1, (index > 0) & active)
        t = invert_line((wanted - before) / width, y0, y1)
        return dr.fma(t, width, x0), dr.fma(t, y1 - y0, y0) / total


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
        super().__init__(pdf, self._sizes())

    @property
    def nodes(self) -> Float:
        """The nodes of the number."""
        return self._nodes

    @nodes.setter
    def nodes(self, value: Any) -> None:
        self._nodes = Float(value)

    @property
    def nodes_cond(self) -> list[Float]:
        """The nodes of each condition."""
        return self._nodes_cond

    @nodes_cond.setter
    def nodes_cond(self, value: Sequence[Any]) -> None:
        self._nodes_cond = [Float(nodes) for nodes in value]

    def _count(self) -> int:
        return len(self._nodes)

    def _sizes(self) -> tuple[int, ...]:
        return tuple(len(nodes) for nodes in self._nodes_cond)

    def _node(self, index: UInt32, active: Bool | bool = True) -> Float:
        return dr.gather(Float, self._nodes, index, active)

    def _find(self, x: Float, active: Bool | bool) -> tuple[UInt32, Bool]:
        return self._search(self._nodes, x, active)

    def _condition(self, axis: int, x: Float, active: Bool | bool) -> tuple[UInt32, Float, Bool]:
        nodes = self._nodes_cond[axis]
        index, inside = self._search(nodes, x, active)
        low, high = dr.gather(Float, nodes, index, active), dr.gather(Float, nodes, index + 1, active)
        return index, dr.clip((x - low) / (high - low), 0, 1), inside

    def _search(self, nodes: Float, x: Float, active: Bool | bool) -> tuple[UInt32, Bool]:
        last = len(nodes) - 1
        found = first_without(0, last + 1, lambda i: dr.gather(Float, nodes, i, active) < x)
        inside = (x >= dr.gather(Float, nodes, UInt32(0))) & (x <= dr.gather(Float, nodes, UInt32(last)))
        return dr.clip(found, 1, last) - 1, inside

    def __repr__(self) -> str:
        return f"ConditionalIrregular1D[\n  shape = {tuple(self._pdf.shape)}\n]"


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

    @property
    def range(self) -> Any:
        """The first node and the last, a `drjit.scalar.Array2f`."""
        return self._range

    @range.setter
    def range(self, value: Any) -> None:
        self._range = dr.scalar.Array2f(*(float(x) for x in value))

    @property
    def range_cond(self) -> list[Any]:
        """The first node and the last of each condition."""
        return self._range_cond

    @range_cond.setter
    def range_cond(self, value: Sequence[Any]) -> None:
        self._range_cond = [dr.scalar.Array2f(*(float(x) for x in pair)) for pair in value]

    def _count(self) -> int:
        return self._pdf.shape[-1]

    def _sizes(self) -> tuple[int, ...]:
        return tuple(self._pdf.shape[:-1])

    def _node(self, index: UInt32, active: Bool | bool = True) -> Float:
        low, high = self._range
        return dr.fma(Float(index), (high - low) / (self._count() - 1), low)

    def _find(self, x: Float, active: Bool | bool) -> tuple[UInt32, Bool]:
        place, inside = self._place(self._range, self._count(), x)
        return UInt32(dr.clip(place, 0, self._count() - 2)), inside

    def _condition(self, axis: int, x: Float, active: Bool | bool) -> tuple[UInt32, Float, Bool]:
        size = self._sizes()[axis]
        place, inside = self._place(self._range_cond[axis], size, x)
        index = UInt32(dr.clip(place, 0, size - 2))
        return index, dr.clip(place - Float(index), 0, 1), inside

    def _place(self, between: Any, count: int, x: Float) -> tuple[Float, Bool]:
        low, high = between
        return (x - low) * ((count - 1) / (high - low)), (x >= low) & (x <= high)

    def __repr__(self) -> str:
        return f"ConditionalRegular1D[\n  shape = {tuple(self._pdf.shape)}\n]"
