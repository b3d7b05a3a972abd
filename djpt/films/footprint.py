"""The pixels reached by light at a point of the film, the transpose, and sums that any lane may add to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.films.base import Film
from djpt.jit.kernels import as_float, while_loop
from djpt.jit.types import Array4f, Array4i64, Bool, Color3f, Float, Float64, Int64, Point2f, UInt32
from djpt.rfilters.base import is_wide

__all__ = ["ChangeSplats", "Splats", "SpreadReader", "in_window"]

STEPS = 64
"""Places on a pixel at which filters are looked at to find the fraction of them that lies inside of the film."""

Visit = Callable[..., tuple[Any, ...]]
"""``visit(pixel, color, inside, *state)``: takes a pixel's part of a colour where it is `inside` of the crop window,
and returns the new state, a tuple."""


def in_window(position: Point2f) -> Bool:
    """True where a position is in the crop window, [0, 1)^2."""
    return (position.x >= 0) & (position.x < 1) & (position.y >= 0) & (position.y < 1)


class Footprint:
    """The pixels of a film's crop window that receive light at a place, by its filter, whose weights sum up to 1."""

    def __init__(self, film: Film) -> None:
        self._film = film
        width, height = film.crop_size()
        self._size = Point2f(as_float(width), as_float(height))
        self._columns, self._rows = dr.opaque(UInt32, width), dr.opaque(UInt32, height)

    def spread(
        self, position: Point2f, color: Color3f, first: UInt32, state: tuple[Any, ...], visit: Visit
    ) -> tuple[Any, ...]:
        """Visit the pixels about a position in [0, 1)^2 with their parts of a colour; they are numbered from `first`.

        Returns the state after the last visit: a tuple of arrays that visits change.
        """
        x, y = position.x * self._size.x, position.y * self._size.y
        column, row = UInt32(x), UInt32(y)
        film = self._film
        if not film.filters:
            return visit(first + row * self._columns + column, color, Bool(True), *state)
        if is_wide(film.taps):
            return self._spread_widely(first, x, y, color, state, visit)
        reach, steps = film.taps // 2, range(film.taps)
        # Before the first column and row the numbers wrap around to large ones.
        column, row = column - reach, row - reach
        in_x, in_y = self._weights(x), self._weights(y)
        color = color * dr.rcp(sum(in_x[1:], in_x[0]) * sum(in_y[1:], in_y[0]))
        for j, wy in zip(steps, in_y, strict=True):
            for i, wx in zip(steps, in_x, strict=True):
                inside = (column + i < self._columns) & (row + j < self._rows)
                pixel = first + (row + j) * self._columns + (column + i)
                state = visit(pixel, color * (wx * wy), inside, *state)
        return state

    def shares(self, position: Point2f, color: Color3f, active: Bool) -> list[tuple[UInt32, Color3f, Bool]]:
        """The pixels about a position, their parts of a colour, and where they receive them; not by wide filters."""
        found: list[tuple[UInt32, Color3f, Bool]] = []

        def keep(pixel: UInt32, share: Color3f, inside: Bool) -> tuple[()]:
            found.append((pixel, share, active & inside))
            return ()

        self.spread(position, color, UInt32(0), (), keep)
        return found

    def _weights(self, place: Float) -> list[Float]:
        """The filter's weights at the pixels about a column or row, the farthest before it first."""
        weight, reach = self._film.rfilter().eval, self._film.taps // 2
        return [weight(place - dr.floor(place) + (reach - i - 0.5)) for i in range(self._film.taps)]

    def _spread_widely(
        self, first: UInt32, x: Float, y: Float, color: Color3f, state: tuple[Any, ...], visit: Visit
    ) -> tuple[Any, ...]:
        """`spread` at a place in pixels by loops over the pixels in reach, too many to be unrolled."""
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

        def step(n: UInt32, *state: Any) -> tuple[Any, ...]:
            j = n // taps
            i = n - j * taps
            inside = (column + i < self._columns) & (row + j < self._rows)
            part = color * (weight(left - Float(i)) * weight(top - Float(j)))
            return n + 1, *visit(first + (row + j) * self._columns + (column + i), part, inside, *state)

        visits = taps * taps
        found: tuple[Any, ...] = while_loop(
            (dr.zeros(UInt32, lanes), *state), lambda n, *_: n < visits, step, label="wide splat"
        )
        return found[1:]

    def shares_inside(self) -> Float:
        """The fraction of the filter that lies within the crop window, for each of its pixels, row by row."""
        width, height = self._film.crop_size()
        pixel = dr.arange(UInt32, width * height)
        row = pixel // self._columns
        return self._inside(pixel - row * self._columns, self._columns) * self._inside(row, self._rows)

    def _inside(self, place: UInt32, count: UInt32) -> Float:
        """The fraction of the filter that lies within the `count` columns or rows, for the pixel at each `place`."""
        weights = self._weights((dr.arange(Float, STEPS) + 0.5) / STEPS)
        total, reach = sum(weights[1:], weights[0]), self._film.taps // 2
        shares = [dr.mean(weight / total) for weight in weights]
        # Light from `reach - i` pixels further on; before the first one numbers wrap around to large ones.
        return sum((dr.select(place + reach - i < count, share, 0) for i, share in enumerate(shares)), Float(0))


class SpreadReader(Footprint):
    """The transpose of `Footprint.spread`: what the pixels about a place hold, times their weights there.

    It turns the derivatives of a loss with respect to pixels into the derivative with respect to light at the place.
    """

    _memory: Any
    """Four numbers per pixel, the last without a meaning."""

    def hold(self, pixels: Color3f) -> None:
        """Set what the pixels of the crop window hold, row by row."""
        self._memory = dr.ravel(Array4f(*pixels, Float(0)))
        dr.eval(self._memory)

    def at(self, position: Point2f, active: Bool) -> Color3f:
        """The weighted sum about a position in [0, 1)^2; 0 on lanes that aren't `active`."""

        def read(pixel: UInt32, share: Color3f, inside: Bool, found: Color3f) -> tuple[Color3f]:
            texel = dr.gather(Array4f, self._memory, pixel, active & inside)
            part = share * Color3f(texel.x, texel.y, texel.z)
            return (found + dr.select(active & inside, part, 0),)

        start = dr.zeros(Color3f, dr.width(position))
        (found,) = self.spread(position, Color3f(1), UInt32(0), (start,), read)
        return found


# ---- sums that any lane may add to, at any pixel ---------------------------------------------


DIGITS = 32
"""Binary digits behind the point, in units of `unit`: as many are left before it, less one."""


class Splats(Footprint):
    """The sums of three channels per pixel of the crop window, as whole numbers; in one or more layers."""

    def __init__(self, film: Film, unit: float, layers: int = 1) -> None:
        """`unit`: a colour of usual size, which decides on the digits; a power of two."""
        super().__init__(film)
        self._scale = as_float(2.0**DIGITS / unit)
        self._layers, self._count = layers, film.crop_size().x * film.crop_size().y
        self._pixels = dr.opaque(UInt32, self._count)
        # One number in four is only there to make a packet.
        self.memory: Any = dr.zeros(Int64, 4 * self._count * layers)
        dr.eval(self.memory)

    def add(self, position: Point2f, color: Color3f, active: Bool, layer: UInt32 | int = 0) -> None:
        """Add a colour at a position in [0, 1)^2 of the crop window, to the first layer or to another one.

        It is weighted with the film's filter, whose weights are made to sum up to 1.
        """

        def add(pixel: UInt32, part: Color3f, inside: Bool) -> tuple[()]:
            self.put(pixel, part, active & inside)
            return ()

        first = UInt32(0) if self._layers == 1 else layer * self._pixels
        self.spread(position, color * self._scale, first, (), add)

    def put(self, pixel: UInt32, color: Color3f, active: Bool) -> None:
        """Add a colour, in units of the sums, to those of a pixel."""
        whole = [Int64(dr.round(c)) for c in color]
        dr.scatter_add(self.memory, Array4i64(*whole, Int64(0)), pixel, active)

    def sums(self, layer: int = 0, continued: bool = False) -> list[Float]:
        """The three channels of a layer, pixel by pixel.

        Pixels near the border are divided by the fraction of the filter that lies inside, so that the weights of what
        they receive sum up to 1; unless it is `continued` outside, by other samples that count there.
        """
        inverse = Float64(1) / Float64(self._scale)
        if self._film.filters and not continued:
            inverse = inverse / Float64(self.shares_inside())
        entry = 4 * (dr.arange(UInt32, self._count) + dr.opaque(UInt32, layer * self._count))
        kind = type(self.memory)
        return [Float(Float64(dr.gather(kind, self.memory, entry + c)) * inverse) for c in range(3)]


class ChangeSplats(Splats):
    """Sums of derivatives, whose magnitude isn't known in advance: in double precision; their last bits may vary."""

    def __init__(self, film: Film) -> None:
        super().__init__(film, 2.0**DIGITS)
        self.memory = dr.zeros(Float64, 4 * self._count)
        dr.eval(self.memory)

    def put(self, pixel: UInt32, color: Color3f, active: Bool) -> None:
        for c, change in enumerate(color):
            dr.scatter_add(self.memory, Float64(change), 4 * pixel + c, active)
