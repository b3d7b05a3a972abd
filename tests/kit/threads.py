"""The number of threads that kernels run in, for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr

__all__ = ["threads"]


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Run kernels in so many threads; the calling one is one of them."""
    before = dr.thread_count()
    dr.set_thread_count(count)
    try:
        yield
    finally:
        dr.set_thread_count(before)
