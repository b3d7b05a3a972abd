"""Distributions of one number, given by tables: cells with weights, and lines between nodes.

All are sampled by inverting running sums; tables may have gradients.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.forms import forms
from djpt.distributions.search import equidistant, first_without, segment_of, within
from djpt.errors import ArgumentError
from djpt.jit.types import Bool, Float, UInt32, converting

__all__ = ["ContinuousDistribution", "DiscreteDistribution", "IrregularContinuousDistribution", "invert_line"]


def search(cdf: Float, total: Float, wanted: Float, active: Bool | bool) -> UInt32:
    """The first entry of running sums that isn't below `wanted`; never one without weight, at either end."""

    def before(index: UInt32) -> Bool:
        value = dr.gather(Float, cdf, index, active)
        return ((value < wanted) | (value == 0)) & (value != total)

    return first_without(0, len(cdf) - 1, before)


def previous(cdf: Float, index: UInt32, active: Bool | bool) -> Float:
    """The running sum before an entry."""
    return dr.gather(Float, cdf, index - 1, (index > 0) & active)


class Table:
    """The base of all distributions: a table, its running sums, and its total."""

    def __init__(self, values: Float) -> None:
        self._values = values
        self._cdf = Float()
        self._sum = Float(0)
        self._normalization = Float(0)

    def update(self) -> None:
        """Compute the running sums again after an edit."""
        raise NotImplementedError

    def _sums(self, cdf: Float) -> None:
        self._cdf = cdf
        self._sum = dr.gather(Float, cdf, UInt32(len(cdf) - 1))
        self._normalization = dr.rcp(self._sum)

    def _refuse(self, problem: str) -> None:
        raise ArgumentError(f"{type(self).__name__}: {problem}!")

    @property
    def cdf(self) -> Float:
        """Running sums, not normalised."""
        return self._cdf

    @cdf.setter
    def cdf(self, value: Any) -> None:
        self._cdf = Float(value)

    def normalization(self) -> Float:
        """The factor that makes the sum, or the integral, 1."""
        return self._normalization

    def size(self) -> int:
        """The number of entries."""
        return len(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def empty(self) -> bool:
        """Whether there are no entries."""
        return len(self._values) == 0


class DiscreteDistribution(Table):
    """Numbers 0, 1 ... by their weights.

    Args:
        pmf: weights, not negative; or another distribution to copy. Without it the distribution is empty, and an
            assignment to `pmf` and `update` fill it.
    """

    def __init__(self, pmf: Any = None) -> None:
        weights = pmf.pmf if isinstance(pmf, DiscreteDistribution) else pmf
        super().__init__(Float() if weights is None else Float(weights))
        if pmf is not None:
            self.update()

    @property
    def pmf(self) -> Float:
        """The weights, as they were given."""
        return self._values

    @pmf.setter
    def pmf(self, value: Any) -> None:
        self._values = Float(value)

    def update(self) -> None:
        if self.empty():
            self._refuse("empty distribution")
        self._sums(dr.cumsum(self._values))

    def sum(self) -> Float:
        """The sum of the weights."""
        return self._sum

    @converting
    def eval_pmf(self, index: UInt32, active: Bool | bool = True) -> Float:
        """The weight of a number."""
        return dr.gather(Float, self._values, index, active)

    def eval_pmf_normalized(self, index: Any, active: Bool | bool = True) -> Float:
        """The probability of a number."""
        return self.eval_pmf(index, active) * self._normalization

    @converting
    def eval_cdf(self, index: UInt32, active: Bool | bool = True) -> Float:
        """The sum of the weights up to a number, itself included."""
        return dr.gather(Float, self._cdf, index, active)

    def eval_cdf_normalized(self, index: Any, active: Bool | bool = True) -> Float:
        """The probability of the numbers up to this one."""
        return self.eval_cdf(index, active) * self._normalization

    @converting
    def sample(self, value: Float, active: Bool | bool = True) -> UInt32:
        """A number, by a uniform number in [0, 1]."""
        return search(self._cdf, self._sum, value * self._sum, active)

    def sample_pmf(self, value: Any, active: Bool | bool = True) -> tuple[UInt32, Float]:
        """A number and its probability."""
        index = self.sample(value, active)
        return index, self.eval_pmf_normalized(index, active)

    def sample_reuse(self, value: Any, active: Bool | bool = True) -> tuple[UInt32, Float]:
        """A number, and a uniform number again: what is left of `value`."""
        return self.sample_reuse_pmf(value, active)[:2]

    @converting
    def sample_reuse_pmf(self, value: Float, active: Bool | bool = True) -> tuple[UInt32, Float, Float]:
        """A number, what is left of `value`, and the number's probability."""
        index, probability = self.sample_pmf(value, active)
        before = previous(self._cdf, index, active) * self._normalization
        return index, (value - before) / probability, probability

    def __repr__(self) -> str:
        if self.empty():
            return "DiscreteDistribution[\n  size = 0\n]"
        return f"DiscreteDistribution[\n  size = {len(self)},\n  sum = {self._sum},\n  pmf = {self._values}\n]"


class Interpolant(Table):
    """A density that is linear between nodes."""

    _nodes: Float
    _largest = 0.0

    @property
    def pdf(self) -> Float:
        """The density at the nodes, as it was given."""
        return self._values

    @pdf.setter
    def pdf(self, value: Any) -> None:
        self._values = Float(value)

    def integral(self) -> Float:
        """The integral of the density as it was given."""
        return self._sum

    def max(self) -> float:
        """The largest entry."""
        return self._largest

    def _node(self, index: UInt32, active: Bool | bool = True) -> Float:
        return dr.gather(Float, self._nodes, index, active)

    def _check_values(self) -> None:
        if not dr.all(self._values >= 0):
            self._refuse("entries must be non-negative")
        if not dr.any(self._values > 0):
            self._refuse("no probability mass found")

    def _accumulate(self) -> None:
        """Integrate the segments."""
        index = dr.arange(UInt32, len(self._values) - 1)
        y0, y1 = (dr.gather(Float, self._values, i) for i in (index, index + 1))
        widths = self._node(index + 1) - self._node(index)
        self._largest = float(dr.max(dr.detach(self._values))[0])
        self._sums(dr.cumsum(0.5 * widths * (y0 + y1)))

    def _segment(self, index: UInt32, active: Bool | bool) -> tuple[Float, Float, Float, Float]:
        """A segment: where it begins, its width, and the density at both ends."""
        x0 = self._node(index, active)
        y0, y1 = (dr.gather(Float, self._values, i, active) for i in (index, index + 1))
        return x0, self._node(index + 1, active) - x0, y0, y1

    @converting
    def eval_pdf(self, x: Float, active: Bool | bool = True) -> Float:
        """The density as it was given, 0 outside of the range."""
        active = within(self._nodes, x) & active
        x0, width, y0, y1 = self._segment(segment_of(self._nodes, x, active), active)
        return dr.select(active, dr.fma((x - x0) / width, y1 - y0, y0), 0)

    def eval_pdf_normalized(self, x: Any, active: Bool | bool = True) -> Float:
        """The density, with the integral 1."""
        return self.eval_pdf(x, active) * self._normalization

    @converting
    def eval_cdf(self, x: Float, active: Bool | bool = True) -> Float:
        """The integral of the density as it was given, up to `x`."""
        index = segment_of(self._nodes, x, active)
        x0, width, y0, y1 = self._segment(index, active)
        t = dr.clip((x - x0) / width, 0, 1)
        return dr.fma(t, dr.fma(0.5 * t, y1 - y0, y0) * width, previous(self._cdf, index, active))

    def eval_cdf_normalized(self, x: Any, active: Bool | bool = True) -> Float:
        """The probability of numbers up to `x`."""
        return self.eval_cdf(x, active) * self._normalization

    def sample(self, value: Any, active: Bool | bool = True) -> Float:
        """A number, by a uniform number in [0, 1]."""
        return self.sample_pdf(value, active)[0]

    @converting
    def sample_pdf(self, value: Float, active: Bool | bool = True) -> tuple[Float, Float]:
        """A number and its density."""
        wanted = value * self._sum
        index = search(self._cdf, self._sum, wanted, active)
        x0, width, y0, y1 = self._segment(index, active)
        t = invert_line((wanted - previous(self._cdf, index, active)) / width, y0, y1)
        return dr.fma(t, width, x0), dr.fma(t, y1 - y0, y0) * self._normalization


def invert_line(area: Float, y0: Float, y1: Float) -> Float:
    """The t at which the integral of the line from `y0` (t = 0) to `y1` (t = 1) is `area`."""
    root = dr.safe_sqrt(dr.fma(y0, y0, 2 * area * (y1 - y0)))
    return dr.select(y0 == y1, area / y0, (y0 - root) / (y0 - y1))


class ContinuousDistribution(Interpolant):
    """A density that is linear between equidistant nodes.

    Args:
        range: the first node and the last.
        pdf: the density at the nodes, at least two, not negative; its integral may have any value.

    Without arguments it is empty; with another distribution, a copy.
    """

    @forms("range pdf", "|", "distribution")
    def __init__(self, *, range: Any = (0, 0), pdf: Any = None, distribution: Any = None) -> None:
        if distribution is not None:
            range, pdf = distribution.range, distribution.pdf
        super().__init__(Float() if pdf is None else Float(pdf))
        self.range = range
        if pdf is not None:
            self.update()

    @property
    def range(self) -> Any:
        """The first node and the last, a `drjit.scalar.Array2f`."""
        return self._range

    @range.setter
    def range(self, value: Any) -> None:
        self._range = dr.scalar.Array2f(*(float(x) for x in value))

    def update(self) -> None:
        if len(self._values) < 2:
            self._refuse("needs at least two entries")
        if not self._range.x < self._range.y:
            self._refuse("invalid range")
        self._check_values()
        self._nodes = equidistant(self._range, len(self._values))
        self._accumulate()

    def interval_resolution(self) -> float:
        """The distance between neighbouring nodes."""
        step: float = (self._range.y - self._range.x) / (len(self._values) - 1)
        return step

    def __repr__(self) -> str:
        return (
            f"ContinuousDistribution[\n  size = {len(self)},\n  range = {self._range},\n"
            f"  integral = {self._sum},\n  pdf = {self._values}\n]"
        )


class IrregularContinuousDistribution(Interpolant):
    """A density that is linear between nodes of any distances.

    Args:
        nodes: in increasing order.
        pdf: the density at the nodes, at least two, not negative; its integral may have any value.

    Without arguments it is empty; with another distribution, a copy.
    """

    @forms("nodes pdf", "|", "distribution")
    def __init__(self, *, nodes: Any = None, pdf: Any = None, distribution: Any = None) -> None:
        if distribution is not None:
            nodes, pdf = distribution.nodes, distribution.pdf
        super().__init__(Float() if pdf is None else Float(pdf))
        self._nodes = Float() if nodes is None else Float(nodes)
        if pdf is not None:
            self.update()

    @property
    def nodes(self) -> Float:
        """The nodes."""
        return self._nodes

    @nodes.setter
    def nodes(self, value: Any) -> None:
        self._nodes = Float(value)

    @property
    def range(self) -> Any:
        """The first node and the last, a `drjit.scalar.Array2f`."""
        return dr.scalar.Array2f(self._nodes[0], self._nodes[len(self._nodes) - 1])

    def update(self) -> None:
        if len(self._nodes) != len(self._values):
            self._refuse("'pdf' and 'nodes' size mismatch")
        if len(self._values) < 2:
            self._refuse("needs at least two entries")
        if not dr.all(self._widths() > 0):
            self._refuse("node positions must be strictly increasing")
        self._check_values()
        self._accumulate()

    def _widths(self) -> Float:
        index = dr.arange(UInt32, len(self._nodes) - 1)
        return dr.gather(Float, self._nodes, index + 1) - dr.gather(Float, self._nodes, index)

    def interval_resolution(self) -> float:
        """The smallest distance of neighbouring nodes."""
        return float(dr.min(self._widths())[0])

    def __repr__(self) -> str:
        return (
            f"IrregularContinuousDistribution[\n  size = {len(self)},\n  nodes = {self._nodes},\n"
            f"  integral = {self._sum},\n  pdf = {self._values}\n]"
        )
