"""Sums that any lane may add to, at any pixel.

Floating-point sums depend on the order of additions, and threads add in any order. Sums of whole numbers don't. So
contributions are scaled and rounded to 64-bit numbers: an image is the same, bit for bit, for any number of threads.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.films.base import Film
from djpt.films.footprint import Footprint
from djpt.jit.kernels import as_float
from djpt.jit.types import Array4i64, Bool, Color3f, Float, Float64, Int64, Point2f, UInt32

__all__ = ["ChangeSplats", "Splats"]

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
            self._add(pixel, part, active & inside)
            return ()

        first = UInt32(0) if self._layers == 1 else layer * self._pixels
        self.spread(position, color * self._scale, first, (), add)

    def _add(self, pixel: UInt32, color: Color3f, active: Bool) -> None:
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
    """Sums of changes, whose size nobody knows before: numbers in double precision, whose last bits may vary."""

    def __init__(self, film: Film) -> None:
        super().__init__(film, 2.0**DIGITS)
        self.memory = dr.zeros(Float64, 4 * self._count)
        dr.eval(self.memory)

    def _add(self, pixel: UInt32, color: Color3f, active: Bool) -> None:
        for c, change in enumerate(color):
            dr.scatter_add(self.memory, Float64(change), 4 * pixel + c, active)
