"""The build by object medians: each half of a node's primitives goes to one side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.tree import BinaryTree, fitted

__all__ = ["build_by_medians"]


def build_by_medians(low: NDArray[np.float32], high: NDArray[np.float32]) -> BinaryTree:
    """Split every node at the median centroid along the longest axis of its centroids' bounds.

    The tree is as shallow as possible, but takes no account of empty space.
    """
    center = low + high
    order = np.arange(len(low), dtype=np.int32)
    start, size = np.zeros(1, np.int32), np.array([len(low)], np.int32)
    lefts, leaves, levels = [], [], [0]
    while len(size):
        inner = size > 1
        end = levels[-1] + len(size)
        left = np.full(len(size), -1, np.int32)
        left[inner] = end + 2 * np.arange(inner.sum(), dtype=np.int32)
        lefts.append(left)
        leaves.append(np.where(inner, np.int32(-1), order[start]))
        levels.append(end)
        start, size = start[inner], size[inner]
        if len(size):
            sort_along_longest(center, order, start, size)
        half = size // 2
        start = np.stack([start, start + half], axis=1).ravel()
        size = np.stack([half, size - half], axis=1).ravel()
    return fitted(np.concatenate(lefts), np.concatenate(leaves), levels, low, high)


def sort_along_longest(
    center: NDArray[np.float32], order: NDArray[np.int32], start: NDArray[np.int32], size: NDArray[np.int32]
) -> None:
    """Sort the range of `order` of each node along its longest axis."""
    segment = np.repeat(np.arange(len(size), dtype=np.int32), size)
    offset = np.cumsum(size, dtype=np.int32) - size
    where = np.arange(len(segment), dtype=np.int32) + (start - offset)[segment]
    primitives = order[where]
    points = center[primitives]
    extent = np.maximum.reduceat(points, offset) - np.minimum.reduceat(points, offset)
    along = points[np.arange(len(points)), extent.argmax(axis=1)[segment]]
    order[where] = primitives[np.lexsort((along, segment))]
