"""Minimum and maximum as one comparison and one select.

`dr.minimum` and `dr.maximum` propagate NaNs and take three instructions for it. In the inner
loop of a path tracer that costs 15 % (docs/performance.md); where no operand can be NaN, or a
NaN does no harm, these do the same work.
"""

from __future__ import annotations

import drjit as dr

from djpt.types import Float

__all__ = ["maximum", "minimum"]


def minimum(a: Float, b: Float | float) -> Float:
    """The smaller of the two; `b` if either is NaN."""
    return dr.select(a < b, a, b)


def maximum(a: Float, b: Float | float) -> Float:
    """The larger of the two; `b` if either is NaN."""
    return dr.select(a > b, a, b)
