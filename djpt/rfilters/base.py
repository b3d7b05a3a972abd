"""The contract of reconstruction filters."""

from __future__ import annotations

from typing import ClassVar

from djpt.description.plugin import Plugin
from djpt.types import Float

__all__ = ["ReconstructionFilter"]


class ReconstructionFilter(Plugin):
    """A separable, symmetric kernel w(x, y) = eval(x) eval(y) that spreads samples over pixels.

    Distances are in pixels. The film divides by the sum of weights, so kernels need not
    integrate to one.
    """

    kind: ClassVar[str] = "rfilter"

    radius: float
    """The distance, in pixels, beyond which `eval` is 0."""

    def eval(self, x: Float) -> Float:
        """The kernel at distance `x`, which may be negative."""
        raise NotImplementedError
