"""Searches in sorted numbers, lane by lane."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr

from djpt.jit.types import Bool, UInt32

__all__ = ["find_interval", "first_without"]


def find_interval(size: int, pred: Callable[[UInt32], Bool]) -> UInt32:
    """The last index i in [0, size - 2] with `pred(i)`, or 0, if `pred` is first true and then false."""
    return first_without(1, size - 1, pred) - 1


def first_without(start: int, end: int, pred: Callable[[UInt32], Bool]) -> UInt32:
    """The first index from `start` on without `pred(i)`, or `end`; `pred` is first true and then false."""
    return UInt32(dr.binary_search(start, end, lambda i: pred(UInt32(i))))
