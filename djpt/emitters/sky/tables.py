"""The tables of the sky and the sun, and interpolation between their entries."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from djpt.dispatch.tables import entry_at
from djpt.jit.kernels import maximum, minimum, own_floats
from djpt.jit.types import Float, UInt32

__all__ = ["Grid", "bezier_weights", "entries_between", "table"]


@dataclass
class Grid:
    """Numbers on a grid, row by row; the first axis is interpolated away first."""

    numbers: Float
    shape: tuple[int, ...]

    def at(self, position: Float) -> Grid:
        """Interpolate the first axis linearly at a position between 0 and its length less 1.

        `position` has width 1, or one entry for each number of what is left.
        """
        count, rest = self.shape[0], math.prod(self.shape[1:])
        # The ends have the slope of their side.
        inside = (position >= 0) & (position <= count - 1)
        position = dr.select(inside, position, minimum(maximum(position, Float(0)), Float(count - 1)))
        first = UInt32(minimum(dr.floor(dr.detach(position)), Float(count - 2)))
        at = dr.fma(first, rest, dr.arange(UInt32, rest))
        low, high = dr.gather(Float, self.numbers, at), dr.gather(Float, self.numbers, at + rest)
        return Grid(dr.lerp(low, high, position - Float(first)), self.shape[1:])

    def swapped(self) -> Grid:
        """The grid with its first two axes exchanged."""
        rows, columns, rest = self.shape[0], self.shape[1], math.prod(self.shape[2:])
        cell = dr.arange(UInt32, rows * columns * rest)
        column, row, inner = cell // (rows * rest), cell // rest % rows, cell % rest
        numbers = dr.gather(Float, self.numbers, (row * columns + column) * rest + inner)
        return Grid(numbers, (columns, rows, *self.shape[2:]))

    def curve(self, position: Float) -> Grid:
        """The Bezier curve whose control points stand along the first axis, at a position in [0, 1]."""
        count, rest = self.shape[0], math.prod(self.shape[1:])
        result = Float(0)
        for k, weight in enumerate(bezier_weights(count, position)):
            result = result + weight * dr.gather(Float, self.numbers, dr.arange(UInt32, rest) + k * rest)
        return Grid(result, self.shape[1:])


def entries_between(entries: Any, count: int, position: Float) -> Any:
    """The linear interpolation of a table of `count` entries at a position between 0 and `count` - 1, per lane."""
    position = minimum(maximum(position, Float(0)), Float(count - 1))
    first = UInt32(minimum(dr.floor(position), Float(count - 2)))
    return dr.lerp(entry_at(entries, first), entry_at(entries, first + 1), position - Float(first))


def bezier_weights(count: int, position: Float) -> list[Float]:
    """The weights of the `count` control points of a Bezier curve at a position in [0, 1]."""
    last = count - 1
    return [math.comb(last, k) * power(position, k) * power(1 - position, last - k) for k in range(count)]


def power(base: Float, exponent: int) -> Float:
    """A power with a small whole exponent, by multiplication."""
    return math.prod([base] * exponent, start=Float(1))


def table(name: str) -> Grid:
    """One of the tables.

    Turbidity runs from 1 to 10 in 10 steps, albedo from 0 to 1 in 2, elevations from 2 to 89 degrees in 30:

    * ``sky``: turbidity, albedo, control point (6), quantity (10: the model's parameters A .. G, I and H, and the mean
      radiance), colour (3);
    * ``sun``: turbidity, part of the sky (45), packet (18 of 4): polynomials of the sun's radiance, for each colour by
      powers of elevation (4) and of the cosine on the sun's disc (6);
    * ``irradiance``: turbidity, elevation, quantity: irradiance by the sun (3), its luminance, and the sky's;
    * ``density``: elevation, turbidity, parameter (5) of `djpt.emitters.sky.directions`.
    """
    numbers, shape = _tables()[name]
    return Grid(numbers, shape)


@functools.cache
def _tables() -> dict[str, tuple[Float, tuple[int, ...]]]:
    with np.load(Path(__file__).parent / "hosek_wilkie.npz") as file:
        return {name: (own_floats(file[name]), file[name].shape) for name in file.files}
