"""A binary tree over boxes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["BinaryTree", "fitted", "half_area"]


@dataclass
class BinaryTree:
    """A binary tree over N primitives: 2N - 1 nodes, level by level, node 0 the root."""

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


def fitted(
    left: NDArray[np.int32],
    primitive: NDArray[np.int32],
    levels: list[int],
    low: NDArray[np.float32],
    high: NDArray[np.float32],
) -> BinaryTree:
    """Compute the boxes of a tree, from the leaves up. `levels`: the first node of each level, then the node count.

    The children of a level's inner nodes make up the next level, in the same order.
    """
    box = np.empty((len(left), 6), np.float32)
    leaf = np.flatnonzero(left < 0)
    np.take(low, primitive[leaf], axis=0, out=(own := np.empty((len(leaf), 3), np.float32)))
    box[leaf, :3] = own
    np.take(high, primitive[leaf], axis=0, out=own)
    box[leaf, 3:] = own
    for begin, end in reversed(list(itertools.pairwise(levels))):
        nodes = begin + np.flatnonzero(left[begin:end] >= 0)
        if len(nodes):
            first = left[nodes[0]]
            pairs = box[first : first + 2 * len(nodes)].reshape(-1, 2, 6)
            box[nodes, :3] = np.minimum(pairs[:, 0, :3], pairs[:, 1, :3])
            box[nodes, 3:] = np.maximum(pairs[:, 0, 3:], pairs[:, 1, 3:])
    return BinaryTree(box, left, primitive)
