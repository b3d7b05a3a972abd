"""The refit of a BVH whose primitives have moved: the same tree with new boxes.

Refitting is many times faster than building, but the tree keeps neighbours of old together. When the
boxes have grown too much, it is time to build again: T. Larsson and T. Akenine-Moeller, "Strategies for
Bounding Volume Hierarchy Updates for Ray Tracing of Deformable Models", 2003; C. Lauterbach et al.,
"RT-DEFORM: Interactive Ray Tracing of Dynamic Scenes using BVHs", 2006.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.build.wide import NO_CHILD, WideTree, child_leaf
from djpt.geometry.bvh.statistics import sah_cost

__all__ = ["REBUILD", "grown", "refit"]

REBUILD = 1.5
"""If rays take more than so many times the steps they took at first, the tree is built again."""


def refit(tree: WideTree, low: NDArray[np.float32], high: NDArray[np.float32]) -> WideTree:
    """The tree with boxes for primitives that are now at `low`, `high` (N, 3); N must not change."""
    box = np.zeros_like(tree.box)
    for nodes in reversed(levels(tree)):
        child = tree.child[nodes]
        own = np.zeros((*child.shape, 6), np.float32)
        leaf, inner = child < NO_CHILD, child >= 0
        primitive = child_leaf(child[leaf])
        own[leaf] = np.concatenate([low[primitive], high[primitive]], axis=1)
        # The level below has its boxes already; missing children must not count.
        below, present = box[child[inner]], (tree.child[child[inner]] != NO_CHILD)[:, :, None]
        own[inner, :3] = np.where(present, below[:, :, :3], np.float32(np.inf)).min(axis=1)
        own[inner, 3:] = np.where(present, below[:, :, 3:], np.float32(-np.inf)).max(axis=1)
        box[nodes] = own
    return WideTree(tree.child, box, tree.depth)


def levels(tree: WideTree) -> list[NDArray[np.int32]]:
    """The nodes of each level."""
    result = [np.zeros(1, np.int32)]
    while len(result[-1]):
        child = tree.child[result[-1]]
        result.append(child[child >= 0])
    return result[:-1]


def grown(tree: WideTree, cost_when_built: float) -> float:
    """The SAH cost divided by the cost when the tree was built: above `REBUILD`, build a new one."""
    return sah_cost(tree) / cost_when_built if cost_when_built > 0 else np.inf
