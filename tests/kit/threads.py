"""Kernels in some number of threads: for a while, and with the same bits for any number."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import drjit as dr
import numpy as np

__all__ = ["assert_same_for_any_threads", "threads"]


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Run kernels in so many threads; the calling one is one of them."""
    before = dr.thread_count()
    dr.set_thread_count(count)
    try:
        yield
    finally:
        dr.set_thread_count(before)


def assert_same_for_any_threads(render: Callable[[], np.ndarray]) -> np.ndarray:
    """Assert that an image doesn't depend on the number of threads; returns it."""
    with threads(1):
        first = render()
    with threads(2):
        np.testing.assert_array_equal(render(), first)
    return first
