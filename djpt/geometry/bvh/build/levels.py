"""The construction of a BVH, level by level: all nodes of a level are split at once.

Every node owns a range of the primitives. A kernel chooses where to split each node (`splits`), others
move its primitives to the two sides, in their old order (`ranges`). Boxes come last, from the leaves up.

The tree depends on nothing but the input: no float is summed by several threads.
"""

from __future__ import annotations

import math
from typing import Literal

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.build.median import build_by_medians
from djpt.geometry.bvh.build.ranges import Level, Ranges
from djpt.geometry.bvh.build.splits import binned_split, exact_split, midpoint_split, no_split
from djpt.geometry.bvh.tree import BinaryTree, fitted, half_area
from djpt.jit.types import UInt32

__all__ = ["BinaryTree", "Method", "build", "half_area"]

Method = Literal["sah", "median", "longest_axis"]

EXACT = 12
"""Nodes with at most so many primitives try all splits."""

MANY = 1 << 17
"""With more primitives, memory is given back after the build: Dr.Jit would keep it for later arrays."""


def build(low: NDArray[np.float32], high: NDArray[np.float32], method: Method = "sah") -> BinaryTree:
    """Build a tree over boxes with corners `low`, `high` (N, 3), N >= 1.

    `method`: `sah` minimises the surface area heuristic, `median` gives each side half of the
    primitives, `longest_axis` cuts the longest axis of the centroids' bounds in the middle.
    """
    count = len(low)
    if count == 1:
        return fitted(np.full(1, -1, np.int32), np.zeros(1, np.int32), [0, 1], low, high)
    if method == "median":
        return build_by_medians(low, high)
    left = np.full(2 * count - 1, -1, np.int32)
    levels = [0, 1]
    # Skewed input could make a tree as deep as it has leaves, and the stack of a traversal as long.
    deepest = 2 * math.ceil(math.log2(count)) + 12
    with dr.suspend_grad():
        ranges, level = Ranges.of(low, high)
        while len(level.id):
            next_id = levels[-1]
            left[level.id] = next_id + 2 * np.arange(len(level.id), dtype=np.int32)
            levels.append(next_id + 2 * len(level.id))
            crowded = np.ceil(np.log2(level.size)) >= deepest - len(levels)
            level = ranges.part(level, choose(ranges.records, level, method, crowded), next_id)
        primitive = ranges.leaf.numpy().view(np.int32)
    if count > MANY:
        del ranges
        dr.flush_malloc_cache()
    return fitted(left, primitive, levels, low, high)


def choose(records: UInt32, level: Level, method: Method, crowded: NDArray[np.bool_]) -> UInt32:
    """Choose the splits of a level's nodes, four words each. Nodes that are `crowded` are halved by number."""
    splits = dr.zeros(UInt32, 4 * len(level.id))
    small = level.size <= EXACT
    if method == "sah":
        kinds = [(binned_split, ~small & ~crowded), (exact_split, small & ~crowded)]
    else:
        kinds = [(midpoint_split, ~crowded)]
    for split, which in [*kinds, (lambda records, nodes: no_split(), crowded)]:
        if which.any():
            index, nodes = level.nodes(which)
            dr.scatter(splits, split(records, nodes).words(nodes), index)
    dr.eval(splits)
    return splits
