"""Images that are the same, to the bit, however they are computed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.kit.threads import threads

__all__ = ["assert_same_for_any_threads"]


def assert_same_for_any_threads(render: Callable[[], np.ndarray]) -> np.ndarray:
    """Assert that an image doesn't depend on the number of threads; returns it."""
    with threads(1):
        first = render()
    with threads(2):
        np.testing.assert_array_equal(render(), first)
    return first
