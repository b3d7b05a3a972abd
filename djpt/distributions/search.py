"""The nodes of grids, and searches in them, lane by lane."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.jit.types import Bool, Float, UInt32

__all__ = ["Corners", "corners_around", "equidistant", "find_interval", "first_without", "segment_of", "within"]

Corners = list[tuple[UInt32, Float]]
"""Points of a grid, by number, with weights that add up to 1."""


def find_interval(size: int, pred: Callable[[UInt32], Bool]) -> UInt32:
    """The last index i in [0, size - 2] with `pred(i)`, or 0, if `pred` is first true and then false."""
    return first_without(1, size - 1, pred) - 1


def first_without(start: int, end: int, pred: Callable[[UInt32], Bool]) -> UInt32:
    """The first index from `start` on without `pred(i)`, or `end`; `pred` is first true and then false."""
    return UInt32(dr.binary_search(start, end, lambda i: pred(UInt32(i))))


def equidistant(ends: Any, count: int) -> Float:
    """`count` nodes from the first of two numbers to the second one."""
    low, high = ends
    return Float(np.linspace(float(low), float(high), count, dtype=np.float32))


def within(nodes: Float, x: Float) -> Bool:
    """Whether a number lies between the first node and the last."""
    return (x >= dr.gather(Float, nodes, UInt32(0))) & (x <= dr.gather(Float, nodes, UInt32(len(nodes) - 1)))


def segment_of(nodes: Float, x: Float, active: Bool | bool = True) -> UInt32:
    """The number of the last node below `x`, but neither before the first node nor the last one itself."""
    return find_interval(len(nodes), lambda i: dr.gather(Float, nodes, i, active) < x)


def corners_around(axes: Sequence[Float], place: Sequence[Float], active: Bool | bool) -> Corners:
    """The points of a grid between which linear interpolation at a place takes its values.

    Args:
        axes: the nodes of the grid along each axis, in increasing order; the last axis counts fastest.
        place: a number per axis; beyond the first or last node it counts as that node.
        active: the lanes that read nodes.
    """
    corners: Corners = [(UInt32(0), Float(1))]
    for axis, (nodes, value) in enumerate(zip(axes, place, strict=True)):
        if len(nodes) == 1:
            continue
        stride = math.prod(len(other) for other in axes[axis + 1 :])
        index = segment_of(nodes, value, active)
        low, high = (dr.gather(Float, nodes, index + k, active) for k in (0, 1))
        share = dr.clip((value - low) / (high - low), 0, 1)
        corners = [
            (corner + (index + k) * stride, weight * (share if k else 1 - share))
            for corner, weight in corners
            for k in (0, 1)
        ]
    return corners
