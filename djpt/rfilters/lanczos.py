"""The windowed sinc filter."""

from __future__ import annotations

import math

import drjit as dr

from djpt.description.properties import Properties
from djpt.description.registry import register_rfilter
from djpt.jit.types import Bool, Float
from djpt.rfilters.base import ReconstructionFilter

__all__ = ["Lanczos"]


class Lanczos(ReconstructionFilter):
    """sinc(pi x) sinc(pi x / lobes) within `lobes` pixels: close to the ideal low-pass filter; rings.

    Parameters: `lobes` (default 3).
    """

    statics = ("reach",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.reach = float(props.integer("lobes", 3, low=1, high=16))

    def eval(self, x: Float, active: Bool | bool = True) -> Float:
        x = dr.abs(x)
        a = math.pi * x
        b = a * (1 / self.reach)
        value = dr.sin(a) * dr.sin(b) * dr.rcp(a * b)
        # At the centre the quotient is 0/0 and its limit 1.
        return dr.select(x < 1e-4, Float(1), dr.select(x < self.reach, value, 0))


register_rfilter("lanczos", Lanczos)
