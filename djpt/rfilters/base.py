"""The contract of reconstruction filters."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from djpt.description.plugin import Plugin
from djpt.jit.kernels import KERNELS, Arithmetic
from djpt.jit.types import Bool, Float

__all__ = ["ReconstructionFilter", "is_wide", "tap_centers"]

UNROLLED = 33
"""The most taps along an axis that kernels unroll: those of a gaussian with a `stddev` of 4."""


class ReconstructionFilter(Plugin):
    """A separable, symmetric kernel w(x, y) = eval(x) eval(y) that spreads samples over pixels.

    A filter has a `formula`, or overrides `eval` where the arithmetic lacks what it needs.
    Distances are in pixels. The film divides by the sum of weights, so kernels need not
    integrate to one.
    """

    kind: ClassVar[str] = "rfilter"

    reach: float
    """The distance, in pixels, beyond which `eval` is 0."""

    has_lobes: ClassVar[bool] = True
    """Whether `eval` may be negative somewhere."""

    def radius(self) -> float:
        """The distance, in pixels, beyond which `eval` is 0."""
        return self.reach

    def border_size(self) -> int:
        """The number of pixels, along an axis and to one side, that a sample reaches besides its own."""
        return max(0, math.ceil(self.reach - 0.5))

    def is_box_filter(self) -> bool:
        """Whether the filter is as wide as a pixel, as only the box is."""
        return self.reach == 0.5

    def eval(self, x: Float, active: Bool | bool = True) -> Float:
        """The kernel at distance `x`, which may be negative: by `formula`, unless a filter has none."""
        result: Float = self.formula(KERNELS, x)
        return result

    def eval_discretized(self, x: Float, active: Bool | bool = True) -> Float:
        """`eval`: kernels compute the filter exactly, where Mitsuba reads a table."""
        return self.eval(x, active)

    def formula(self, m: Arithmetic, x: Any) -> Any:
        """`eval` by the functions of an arithmetic: also compiled functions can then weigh samples."""
        raise NotImplementedError

    @property
    def has_formula(self) -> bool:
        """Whether `eval` is `formula`."""
        return type(self).eval is ReconstructionFilter.eval


def is_wide(taps: int) -> bool:
    """Whether a filter with this many taps along an axis is evaluated in loops."""
    return taps > UNROLLED


def tap_centers(count: int) -> list[float]:
    """The middles of the `count` columns or rows around a sample's pixel, an odd number, from the pixel's corner."""
    return [i - count // 2 + 0.5 for i in range(count)]
