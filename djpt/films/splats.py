"""Sums that any lane may add to, at any pixel.

Floating-point sums depend on the order of additions, and threads add in any order. Sums of whole numbers don't. So
contributions are scaled and rounded to 64-bit numbers: an image is the same, bit for bit, for any number of threads.
"""

from __future__ import annotations

import drjit as dr

from djpt.films.base import Film
from djpt.kernels import as_float, while_loop
from djpt.rfilters.base import is_wide
from djpt.types import Array4i64, Bool, Color3f, Float, Float64, Int64, Point2f, UInt32

__all__ = ["Splats"]

DIGITS = 32
"""Binary digits behind the point, in units of `unit`: as many are left before it, less one."""


class Splats:
    """The sums of three channels per pixel of the crop window, as whole numbers."""

    def __init__(self, film: Film, unit: float) -> None:
        """`unit`: a colour of usual size, which decides on the digits; a power of two."""
        self._film = film
        width, height = film.crop_size()
        self._size = Point2f(as_float(width), as_float(height))
        self._columns, self._rows = dr.opaque(UInt32, width), dr.opaque(UInt32, height)
        self._scale = as_float(2.0**DIGITS / unit)
        # One number in four is only there to make a packet.
        self.memory = dr.zeros(Int64, 4 * width * height)
        dr.eval(self.memory)

    def add(self, position: Point2f, color: Color3f, active: Bool) -> None:
        """Add a colour at a position in [0, 1)^2 of the crop window.

        It is weighted with the film's filter, whose weights are made to sum up to 1.
        """
        x, y = position.x * self._size.x, position.y * self._size.y
        column, row = UInt32(x), UInt32(y)
        color = color * self._scale
        film = self._film
        if not film.filters:
            self._add(row * self._columns + column, color, active)
            return
        if is_wide(film.taps):
            self._add_widely(x, y, color, active)
            return
        reach, weight = film.taps // 2, film.rfilter().eval
        # Before the first column and row the numbers wrap around to large ones.
        column, row, steps = column - reach, row - reach, range(2 * reach + 1)
        in_x = [weight(x - dr.floor(x) + (reach - i - 0.5)) for i in steps]
        in_y = [weight(y - dr.floor(y) + (reach - j - 0.5)) for j in steps]
        color = color * dr.rcp(sum(in_x[1:], in_x[0]) * sum(in_y[1:], in_y[0]))
        for j, wy in zip(steps, in_y, strict=True):
            for i, wx in zip(steps, in_x, strict=True):
                inside = (column + i < self._columns) & (row + j < self._rows)
                self._add((row + j) * self._columns + (column + i), color * (wx * wy), active & inside)

    def _add_widely(self, x: Float, y: Float, color: Color3f, active: Bool) -> None:
        """Add a colour at a place in pixels by loops over the pixels in reach, too many to be unrolled."""
        weight, taps = self._film.rfilter().eval, dr.opaque(UInt32, self._film.taps)
        reach = taps // 2
        column, row, edge = UInt32(x) - reach, UInt32(y) - reach, Float(reach) - 0.5
        left, top = x - dr.floor(x) + edge, y - dr.floor(y) + edge
        lanes = dr.width(x, y)

        def along(i: UInt32, in_x: Float, in_y: Float) -> tuple[UInt32, Float, Float]:
            return i + 1, in_x + weight(left - Float(i)), in_y + weight(top - Float(i))

        start = (dr.zeros(UInt32, lanes), dr.zeros(Float, lanes), dr.zeros(Float, lanes))
        _, in_x, in_y = while_loop(start, lambda i, in_x, in_y: i < taps, along, label="wide splat weights")
        color = color * dr.rcp(in_x * in_y)

        def visit(n: UInt32) -> tuple[UInt32]:
            j = n // taps
            i = n - j * taps
            inside = (column + i < self._columns) & (row + j < self._rows)
            part = color * (weight(left - Float(i)) * weight(top - Float(j)))
            self._add((row + j) * self._columns + (column + i), part, active & inside)
            return (n + 1,)

        while_loop((dr.zeros(UInt32, lanes),), lambda n: n < taps * taps, visit, label="wide splat")

    def _add(self, pixel: UInt32, color: Color3f, active: Bool) -> None:
        whole = [Int64(dr.round(c)) for c in color]
        dr.scatter_add(self.memory, Array4i64(*whole, Int64(0)), pixel, active)

    def sums(self) -> list[Float]:
        """The three channels, pixel by pixel."""
        pixel = dr.arange(UInt32, dr.width(self.memory) // 4)
        inverse = Float64(1) / Float64(self._scale)
        return [Float(Float64(dr.gather(Int64, self.memory, 4 * pixel + c)) * inverse) for c in range(3)]
