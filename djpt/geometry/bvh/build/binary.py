"""Binary trees over boxes, one primitive in each leaf: what `djpt.geometry.bvh.build.wide` makes its nodes of.

They are built by compiled functions, or else by sorting with NumPy: the second is slower, and rays through its trees
take more steps. It works everywhere, and shows what the surface area heuristic is worth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.build.build_functions import BIAS, INNER
from djpt.geometry.bvh.build.builder import binary_nodes
from djpt.geometry.bvh.build.functions import can_compile

__all__ = ["BinaryTree", "Method", "build", "half_area"]

Method = Literal["sah", "median", "longest_axis"]

LARGEST = 1e29
"""Compiled functions can't tell larger coordinates from empty boxes."""


@dataclass
class BinaryTree:
    """A binary tree over N primitives: 2N - 1 nodes, level by level, node 0 the root.

    The children of a level's inner nodes make up the next level, in the same order.
    """

    box: NDArray[np.float32]
    """The boxes, (2N - 1, 6): low xyz, high xyz."""
    left: NDArray[np.int32]
    """The left child of each node, -1 at leaves; the right child is left + 1."""
    primitive: NDArray[np.int32]
    """The primitive of each leaf; -1 at inner nodes."""


def half_area(box: NDArray[np.float32]) -> NDArray[np.float32]:
    """Half the surface area of boxes (..., 6): xy + yz + zx."""
    x, y, z = (box[..., 3 + a] - box[..., a] for a in range(3))
    return x * y + y * z + z * x


def build(low: NDArray[np.float32], high: NDArray[np.float32], method: Method = "sah") -> BinaryTree:
    """Build a tree over boxes with corners `low`, `high` (N, 3), N >= 1.

    `method`: `sah` minimises the surface area heuristic, `median` gives each side half of the
    primitives, `longest_axis` cuts the longest axis of the centroids' bounds in the middle. Where nothing can be
    compiled, and for coordinates beyond 1e29, `sah` is `longest_axis`.
    """
    if method != "sah":
        return build_by_sorting(low, high, method)
    # NaN is beyond all limits, too.
    if can_compile() and max(np.abs(low).max(), np.abs(high).max()) < LARGEST:
        return build_compiled(low, high)
    return build_by_sorting(low, high, "longest_axis")


# ---- by compiled functions ---------------------------------------------------------------------------------------


def build_compiled(low: NDArray[np.float32], high: NDArray[np.float32]) -> BinaryTree:
    """Split nodes by the surface area heuristic, with compiled functions."""
    nodes = binary_nodes(np.concatenate([low, high], axis=1))
    words = nodes.view(np.uint32)
    first, inner = (words[:, 3] - np.uint32(BIAS)).view(np.int32), words[:, 7] >= BIAS + INNER
    levels = [np.array([len(nodes) - 1], np.int32)]
    while len(levels[-1]):
        own = levels[-1]
        left = first[own[inner[own]]]
        levels.append(np.stack([left, left + 1], axis=1).ravel())
    order = np.concatenate(levels)
    box = np.empty((len(order), 6), np.float32)
    box[:, :3] = nodes[order, :3]
    # The high corner has the opposite sign.
    np.negative(nodes[order, 4:7], out=box[:, 3:])
    inner, first = inner[order], first[order]
    left = np.where(inner, 2 * np.cumsum(inner, dtype=np.int32) - 1, np.int32(-1))
    return BinaryTree(box, left, np.where(inner, np.int32(-1), first))


# ---- by sorting --------------------------------------------------------------------------------------------------


def build_by_sorting(low: NDArray[np.float32], high: NDArray[np.float32], method: Method) -> BinaryTree:
    """Split every node along the longest axis of its centroids' bounds, by number or, with `longest_axis`, halfway.

    All nodes of a level are split at once. A tree by number is as shallow as possible, but takes no account of empty
    space.
    """
    center, count = low + high, len(low)
    # Skewed input could make a tree as deep as it has leaves, and the stack of a traversal as long.
    deepest = 2 * math.ceil(math.log2(count)) + 12
    order = np.arange(count, dtype=np.int32)
    start, size = np.zeros(1, np.int32), np.array([count], np.int32)
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
        half = size // 2
        if len(size):
            before = sort_along_longest(center, order, start, size)
            usable = (before > 0) & (before < size) & (np.ceil(np.log2(size)) < deepest - len(levels))
            half = np.where(usable & (method == "longest_axis"), before, half)
        start = np.stack([start, start + half], axis=1).ravel()
        size = np.stack([half, size - half], axis=1).ravel()
    return fitted(np.concatenate(lefts), np.concatenate(leaves), levels, low, high)


def sort_along_longest(
    center: NDArray[np.float32], order: NDArray[np.int32], start: NDArray[np.int32], size: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Sort the range of `order` of each node along its longest axis; how many centroids lie before the middle."""
    segment = np.repeat(np.arange(len(size), dtype=np.int32), size)
    offset = np.cumsum(size, dtype=np.int32) - size
    where = np.arange(len(segment), dtype=np.int32) + (start - offset)[segment]
    primitives = order[where]
    points = center[primitives]
    least, most = np.minimum.reduceat(points, offset), np.maximum.reduceat(points, offset)
    axis = (most - least).argmax(axis=1)
    along = points[np.arange(len(points)), axis[segment]]
    order[where] = primitives[np.lexsort((along, segment))]
    middle = (0.5 * (least + most))[np.arange(len(axis)), axis]
    return np.add.reduceat(along < middle[segment], offset, dtype=np.int32)


def fitted(
    left: NDArray[np.int32],
    primitive: NDArray[np.int32],
    levels: list[int],
    low: NDArray[np.float32],
    high: NDArray[np.float32],
) -> BinaryTree:
    """Compute the boxes of a tree, from the leaves up. `levels`: the first node of each level, then the node count."""
    leaf = left < 0
    box = np.empty((len(left), 6), np.float32)
    box[leaf] = np.concatenate([low[primitive[leaf]], high[primitive[leaf]]], axis=1)
    for begin, end in zip(reversed(levels[:-1]), reversed(levels), strict=False):
        nodes = begin + np.flatnonzero(~leaf[begin:end])
        if len(nodes):
            first = left[nodes[0]]
            pairs = box[first : first + 2 * len(nodes)].reshape(-1, 2, 6)
            box[nodes, :3] = np.minimum(pairs[:, 0, :3], pairs[:, 1, :3])
            box[nodes, 3:] = np.maximum(pairs[:, 0, 3:], pairs[:, 1, 3:])
    return BinaryTree(box, left, primitive)
