"""Comparing what djpt and Mitsuba return."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

__all__ = ["numbers", "same"]


def numbers(value: Any) -> list[Any]:
    """The entries of a Dr.Jit array, or of a Python number."""
    return np.array(dr.detach(value) if dr.is_array_v(value) else value).ravel().tolist()


def same(mine: Any, other: Any, tolerance: float = 1e-6) -> None:
    """Assert that two results are equal in all entries, whatever their types."""
    a, b = (np.atleast_1d(np.array(dr.detach(x) if dr.is_array_v(x) else x)).astype(np.float64) for x in (mine, other))
    width = max(a.shape[-1], b.shape[-1])
    a, b = (np.broadcast_to(x, (*x.shape[:-1], width)) for x in (a, b))
    np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance)
