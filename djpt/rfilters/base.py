"""The contract of reconstruction filters."""

from __future__ import annotations

from typing import Any, ClassVar

from djpt.arithmetic import KERNELS, Arithmetic
from djpt.description.plugin import Plugin
from djpt.types import Float

__all__ = ["ReconstructionFilter", "tap_centers"]


class ReconstructionFilter(Plugin):
    """A separable, symmetric kernel w(x, y) = eval(x) eval(y) that spreads samples over pixels.

    A filter has a `formula`, or overrides `eval` where the arithmetic lacks what it needs.
    Distances are in pixels. The film divides by the sum of weights, so kernels need not
    integrate to one.
    """

    kind: ClassVar[str] = "rfilter"

    radius: float
    """The distance, in pixels, beyond which `eval` is 0."""

    def eval(self, x: Float) -> Float:
        """The kernel at distance `x`, which may be negative: by `formula`, unless a filter has none."""
        result: Float = self.formula(KERNELS, x)
        return result

    def formula(self, m: Arithmetic, x: Any) -> Any:
        """`eval` by the functions of an arithmetic: also compiled functions can then weigh samples."""
        raise NotImplementedError

    @property
    def has_formula(self) -> bool:
        """Whether `eval` is `formula`."""
        return type(self).eval is ReconstructionFilter.eval


def tap_centers(count: int) -> list[float]:
    """The middles of the `count` columns or rows around a sample's pixel, an odd number, from the pixel's corner."""
    return [i - count // 2 + 0.5 for i in range(count)]
