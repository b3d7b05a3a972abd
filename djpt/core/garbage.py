"""Python's collector of garbage, which stops for a while."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["without_garbage"]


@contextmanager
def without_garbage() -> Iterator[None]:
    """Collect no garbage in a ``with`` block.

    Imports and loading make hundreds of thousands of objects that stay. Looking through them again and again would
    take a sixth of the time.
    """
    on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if on:
            gc.enable()
