"""Images that are the same, to the bit, however they are computed."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import numpy as np

__all__ = ["assert_same_for_any_threads"]


def assert_same_for_any_threads(render: Callable[[], np.ndarray]) -> np.ndarray:
    """Assert that an image doesn't depend on the number of threads; returns it."""
    count, first = dr.thread_count(), render()
    try:
        dr.set_thread_count(1)
        np.testing.assert_array_equal(render(), first)
    finally:
        dr.set_thread_count(count)
    return first
