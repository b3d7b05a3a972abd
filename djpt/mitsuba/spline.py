"""Catmull-Rom splines: cubic interpolation with slopes from neighbouring values. The names of `djpt.spline`.

Grids are either regular, given by their first and last node, or given by all nodes, in increasing order. At the ends
slopes are one-sided.

E. Catmull and R. Rom, "A class of local interpolating splines", Computer Aided Geometric Design, 1974.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.core.forms import forms
from djpt.distributions.search import equidistant, find_interval, within
from djpt.errors import ArgumentError
from djpt.jit.kernels import while_loop
from djpt.jit.types import Bool, Float, Int32, UInt32, converting

__all__ = [
    "eval_1d",
    "eval_2d",
    "eval_spline",
    "eval_spline_d",
    "eval_spline_i",
    "eval_spline_weights",
    "integrate_1d",
    "invert_1d",
    "sample_1d",
]


# ---- one segment -----------------------------------------------------------------------------


def eval_spline(f0: Any, f1: Any, d0: Any, d1: Any, t: Any) -> Any:
    """The cubic with the values `f0` and `f1` and the slopes `d0` and `d1` at t = 0 and 1."""
    return sum(w * x for w, x in zip(weights_of(t), (f0, f1, d0, d1), strict=True))


def eval_spline_d(f0: Any, f1: Any, d0: Any, d1: Any, t: Any) -> tuple[Any, Any]:
    """The cubic, and its derivative."""
    u = 1 - t
    slope = 6 * t * u * (f1 - f0) + u * (1 - 3 * t) * d0 + t * (3 * t - 2) * d1
    return eval_spline(f0, f1, d0, d1, t), slope


def eval_spline_i(f0: Any, f1: Any, d0: Any, d1: Any, t: Any) -> tuple[Any, Any]:
    """The integral of the cubic from 0 to `t`, and the cubic."""
    t2 = t * t
    area = t * f0 + t2 * t * (1 - 0.5 * t) * (f1 - f0)
    area = area + t2 * ((0.25 * t - 2 / 3) * t + 0.5) * d0 + t2 * t * (0.25 * t - 1 / 3) * d1
    return area, eval_spline(f0, f1, d0, d1, t)


def weights_of(t: Any) -> tuple[Any, Any, Any, Any]:
    """Hermite's polynomials: the weights of both values and both slopes."""
    u = 1 - t
    rise = t * t * (3 - 2 * t)
    return 1 - rise, rise, t * u * u, -t * t * u


# ---- grids -----------------------------------------------------------------------------------


class Grid:
    """Nodes: `count` equidistant ones from `low` to `high`, or those of an array."""

    def __init__(self, low: Any, high: Any, nodes: Any, count: int) -> None:
        given = "" if nodes is None else f", and {len(Float(nodes))} nodes"
        if count < 2 or (nodes is not None and len(Float(nodes)) != count):
            raise ArgumentError(f"splines have at least two nodes and as many values; found {count} values{given}")
        self.nodes = equidistant((low, high), count) if nodes is None else Float(nodes)
        self.count = count

    def at(self, index: Any, active: Bool | bool = True) -> Float:
        """Node number `index`."""
        return dr.gather(Float, self.nodes, index, active)

    def find(self, x: Float) -> UInt32:
        """The segment that a number lies in, the first or last one if it lies outside."""
        return find_interval(self.count, lambda i: self.at(i) <= x)


class Segment:
    """Segment `index` of a spline: its values and slopes at both ends, per width of the segment."""

    def __init__(self, grid: Grid, values: Float, index: UInt32) -> None:
        before, after = index > 0, index + 2 < grid.count
        self.x0, x1 = grid.at(index), grid.at(index + 1)
        self.width = x1 - self.x0
        f0, f1 = dr.gather(Float, values, index), dr.gather(Float, values, index + 1)
        rise = f1 - f0
        left = (f1 - dr.gather(Float, values, index - 1, before)) / (x1 - grid.at(index - 1, before))
        right = (dr.gather(Float, values, index + 2, after) - f0) / (grid.at(index + 2, after) - self.x0)
        d0 = dr.select(before, self.width * left, rise)
        d1 = dr.select(after, self.width * right, rise)
        self.cubic = f0, f1, d0, d1

    def solve(self, function: Callable[..., tuple[Float, Float]], wanted: Float, start: Float, error: Any) -> Float:
        """The t in [0, 1] at which an increasing function of the cubic, which gives its derivative too, has a value.

        By Newton's steps, and bisection where these leave the interval that is known to hold the solution.
        """

        def step(a: Float, b: Float, t: Float, busy: Bool) -> tuple[Float, Float, Float, Bool]:
            t = dr.select((t > a) & (t < b), t, 0.5 * (a + b))
            value, slope = function(*self.cubic, t)
            value = value - wanted
            busy = busy & (dr.abs(value) > error) & (b - a > 1e-6)
            low = value <= 0
            return dr.select(low, t, a), dr.select(low, b, t), dr.select(busy, t - value / slope, t), busy

        zero = wanted * 0
        state = (zero, zero + 1, start + zero, zero == zero)
        return while_loop(state, lambda a, b, t, busy: busy, step, label="spline")[2]


# ---- splines ---------------------------------------------------------------------------------


@forms("min max values x", "nodes values x")
def eval_1d(*, min: Any = 0, max: Any = 1, nodes: Any = None, values: Any, x: Any) -> Float:
    """The spline through `values` at `x`; 0 outside of the grid."""
    values, x = Float(values), Float(x)
    grid = Grid(min, max, nodes, len(values))
    segment = Segment(grid, values, grid.find(x))
    return dr.select(within(grid.nodes, x), eval_spline(*segment.cubic, (x - segment.x0) / segment.width), 0)


@forms("min max values", "nodes values")
def integrate_1d(*, min: Any = 0, max: Any = 1, nodes: Any = None, values: Any) -> Any:
    """The integrals of the spline from the first node to each node, numbers on the host: a `drjit.scalar.ArrayXf`."""
    values = Float(values)
    grid = Grid(min, max, nodes, len(values))
    segment = Segment(grid, values, dr.arange(UInt32, grid.count - 1))
    f0, f1, d0, d1 = segment.cubic
    areas = ((d0 - d1) / 12 + (f0 + f1) / 2) * segment.width
    return dr.scalar.ArrayXf([0.0, *dr.cumsum(areas).numpy().tolist()])


@forms("min max_ values y | eps", "nodes values y | eps")
def invert_1d(*, min: Any = 0, max_: Any = 1, nodes: Any = None, values: Any, y: Any, eps: float = 1e-6) -> Float:
    """Where a spline that increases has the value `y`: up to `eps` times its last value; the nearest end if nowhere."""
    values, y = Float(values), Float(y)
    grid = Grid(min, max_, nodes, len(values))
    segment = Segment(grid, values, find_interval(grid.count, lambda i: dr.gather(Float, values, i) <= y))
    t = segment.solve(eval_spline_d, y, Float(0.5), eps * values[grid.count - 1])
    x = dr.fma(t, segment.width, segment.x0)
    last = UInt32(grid.count - 1)
    x = dr.select(y >= dr.gather(Float, values, last), grid.at(last), x)
    return dr.select(y <= values[0], grid.at(UInt32(0)), x)


@forms("min max values cdf sample | eps", "nodes values cdf sample | eps")
def sample_1d(
    *, min: Any = 0, max: Any = 1, nodes: Any = None, values: Any, cdf: Any, sample: Any, eps: float = 1e-6
) -> tuple[Float, Float, Float]:
    """A number with a density proportional to the spline, by inversion; `cdf` is the result of `integrate_1d`.

    Returns:
        The number; the spline there; its density.
    """
    values, cdf = Float(values), Float(cdf)
    grid = Grid(min, max, nodes, len(values))
    if len(cdf) != grid.count:
        raise ArgumentError(f"sample_1d(): 'values' and 'cdf' must have the same size, found {grid.count}, {len(cdf)}")
    total = cdf[grid.count - 1]
    area = Float(sample) * total
    index = find_interval(grid.count, lambda i: dr.gather(Float, cdf, i) <= area)
    segment = Segment(grid, values, index)
    area = (area - dr.gather(Float, cdf, index)) / segment.width
    f0, f1 = segment.cubic[:2]
    # The solution for the straight line between both values is near.
    root = dr.safe_sqrt(f0 * f0 + 2 * area * (f1 - f0))
    start = dr.select(f0 != f1, (f0 - root) / (f0 - f1), area / f0)
    t = segment.solve(eval_spline_i, area, start, eps * total)
    value = eval_spline(*segment.cubic, t)
    return dr.fma(t, segment.width, segment.x0), value, value / total


@forms("min max size x", "nodes x")
def eval_spline_weights(
    *, min: Any = 0, max: Any = 1, size: int = 0, nodes: Any = None, x: Any
) -> tuple[Bool, Int32, list[Float]]:
    """The weights of four neighbouring values in the spline at `x`.

    Returns:
        Whether `x` is inside of the grid; the number of the first of the four nodes, which is -1 in the first segment;
        the weights, 0 for nodes that don't exist.
    """
    x = Float(x)
    grid = Grid(min, max, nodes, size if nodes is None else len(Float(nodes)))
    index = grid.find(x)
    x0, x1 = grid.at(index), grid.at(index + 1)
    width = x1 - x0
    w0, w1, s0, s1 = weights_of((x - x0) / width)
    before, after = index > 0, index + 2 < grid.count
    # Slopes are weighted differences of values: over two segments inside, over one at the ends.
    left = dr.select(before, s0 * width / (x1 - grid.at(index - 1, before)), 0)
    right = dr.select(after, s1 * width / (grid.at(index + 2, after) - x0), 0)
    ends = dr.select(before, 0, s0) + dr.select(after, 0, s1)
    return within(grid.nodes, x), Int32(index) - 1, [-left, w0 - ends - right, w1 + ends + left, right]


@converting
def eval_2d(nodes1: Float, nodes2: Float, values: Float, x: Float, y: Float) -> Float:
    """The product spline through values on a grid at (x, y), 0 outside; `values` are in rows of equal y."""
    inside_x, column, along = eval_spline_weights(nodes=nodes1, x=x)
    inside_y, row, across = eval_spline_weights(nodes=nodes2, x=y)
    width = len(nodes1)
    total = Float(0)
    for j, v in enumerate(across):
        for i, u in enumerate(along):
            weight = u * v
            index = (row + j) * width + column + i
            total = total + weight * dr.gather(Float, values, UInt32(index), inside_x & inside_y & (weight != 0))
    return total
