"""Building a BVH, level by level: all nodes of a level are split at once.

A tree has one primitive per leaf. Its primitives are reordered in place as nodes are split, so that
every node owns a range of them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["BinaryTree", "Method", "build", "half_area"]

Method = Literal["sah", "median", "longest_axis"]


@dataclass
class BinaryTree:
    """A binary tree over N primitives: 2N - 1 nodes, level by level, node 0 the root."""

    box: NDArray[np.float32]
    """(2N - 1, 6): low xyz, high xyz."""
    left: NDArray[np.int32]
    """The left child; the right one is left + 1; -1 at leaves."""
    primitive: NDArray[np.int32]
    """The primitive of a leaf; -1 at inner nodes."""


def half_area(box: NDArray[np.float32]) -> NDArray[np.float32]:
    """Half the surface of boxes (..., 6): xy + yz + zx."""
    x, y, z = (box[..., 3 + a] - box[..., a] for a in range(3))
    return x * y + y * z + z * x


def build(low: NDArray[np.float32], high: NDArray[np.float32], method: Method = "sah") -> BinaryTree:
    """A tree over boxes with corners `low`, `high` (N, 3).

    The same input gives the same tree.
    """
    count = len(low)
    centroid = low + high
    order = np.arange(count, dtype=np.int32)
    start, size = np.zeros(1, np.int32), np.array([count], np.int32)
    lefts, leaves, total = [], [], 1
    while True:
        inner = size > 1
        left = np.full(len(size), -1, np.int32)
        left[inner] = total + 2 * np.arange(inner.sum(), dtype=np.int32)
        primitive = np.where(inner, np.int32(-1), order[start])
        lefts.append(left)
        leaves.append(primitive)
        total += 2 * int(inner.sum())
        start, size = start[inner], size[inner]
        if not len(size):
            break
        half = halve(centroid, order, start, size)
        start = np.stack([start, start + half], axis=1).ravel()
        size = np.stack([half, size - half], axis=1).ravel()
    left, primitive = np.concatenate(lefts), np.concatenate(leaves)
    box = np.empty((len(left), 6), np.float32)
    leaf = left < 0
    box[leaf, :3], box[leaf, 3:] = low[primitive[leaf]], high[primitive[leaf]]
    first = np.cumsum([0, *(len(level) for level in lefts)])
    for begin, end in reversed(list(itertools.pairwise(first))):
        nodes = begin + np.flatnonzero(left[begin:end] >= 0)
        pair = left[nodes]
        box[nodes, :3] = np.minimum(box[pair, :3], box[pair + 1, :3])
        box[nodes, 3:] = np.maximum(box[pair, 3:], box[pair + 1, 3:])
    return BinaryTree(box, left, primitive)


def halve(
    centroid: NDArray[np.float32], order: NDArray[np.int32], start: NDArray[np.int32], size: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Sort each node's primitives along its longest axis; returns how many go left."""
    segment = np.repeat(np.arange(len(size), dtype=np.int32), size)
    within = np.arange(size.sum(), dtype=np.int32) - np.repeat(np.cumsum(size, dtype=np.int32) - size, size)
    where = within + np.repeat(start, size)
    primitives = order[where]
    points = centroid[primitives]
    offset = np.cumsum(size) - size
    extent = np.maximum.reduceat(points, offset) - np.minimum.reduceat(points, offset)
    axis = extent.argmax(axis=1)
    along = points[np.arange(len(points)), axis[segment]]
    order[where] = primitives[np.lexsort((along, segment))]
    return size // 2
