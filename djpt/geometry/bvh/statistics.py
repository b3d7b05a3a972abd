"""The quality of a BVH, computed without tracing a ray."""

from __future__ import annotations

import numpy as np

from djpt.geometry.bvh.build.wide import NO_CHILD, WideTree
from djpt.geometry.bvh.tree import BinaryTree, half_area

__all__ = ["sah_cost"]


def sah_cost(tree: BinaryTree | WideTree) -> float:
    """The number of nodes and primitives that a random line through the root's box meets on average.

    A line that meets a convex body meets a body inside it with the probability A(inner) / A(outer) (Crofton's
    formula), so the sum over all boxes is C = 1 + sum A(box) / A(root): every node and every primitive costs 1, one
    step of our traversal. MacDonald and Booth, "Heuristics for Ray Tracing Using Space Subdivision",
    1990. The lines are uniform, come from outside, and nothing stops them.

    0 for trees over a single point or along a line, which have no surface.
    """
    boxes = tree.box[1:] if isinstance(tree, BinaryTree) else tree.box[tree.child != NO_CHILD]
    root = tree.box[0] if isinstance(tree, BinaryTree) else root_box(tree)
    area = float(half_area(root.astype(np.float64)))
    return 1 + float(half_area(boxes).sum(dtype=np.float64)) / area if area > 0 else 0.0


def root_box(tree: WideTree) -> np.ndarray:
    """The bounds of all primitives, (6,): low xyz, high xyz."""
    children = tree.box[0][tree.child[0] != NO_CHILD]
    return np.concatenate([children[:, :3].min(axis=0), children[:, 3:].max(axis=0)])
