"""Wide trees, whose rays take fewer steps through fewer, larger nodes: collapsed from binary ones, weighed, refitted.

H. Dammertz, J. Hanika and A. Keller, "Shallow Bounding Volume Hierarchies for Fast SIMD Ray Tracing of
Incoherent Rays", 2008. Which binary nodes survive is a small dynamic programme: H. Ylitie, T. Karras
and S. Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", 2017.

Refitting is many times faster than building, but the tree keeps neighbours of old together. When the
boxes have grown too much, it is time to build again: T. Larsson and T. Akenine-Moeller, "Strategies for
Bounding Volume Hierarchy Updates for Ray Tracing of Deformable Models", 2003; C. Lauterbach et al.,
"RT-DEFORM: Interactive Ray Tracing of Dynamic Scenes using BVHs", 2006.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.build.binary import BinaryTree, half_area

__all__ = ["NO_CHILD", "REBUILD", "WideTree", "child_leaf", "collapse", "grown", "refit", "sah_cost"]

NO_CHILD = -1


@dataclass
class WideTree:
    """A tree of K nodes with up to W children each; node 0 is the root.

    Nodes stand in depth-first order: nodes that a ray visits one after the other are near in memory, and children
    come after their parents.
    """

    child: NDArray[np.int32]
    """The children, (K, W): >= 0 a node, -1 none (those come last), <= -2 the primitive -2 - child."""
    box: NDArray[np.float32]
    """The children's boxes, (K, W, 6): low xyz, high xyz; zeros where there is no child."""
    depth: int
    """Levels of nodes."""


def child_leaf(primitive: NDArray[np.int32]) -> NDArray[np.int32]:
    """The number by which `WideTree.child` refers to a primitive: -2 - primitive, its own inverse."""
    return -2 - primitive


def collapse(tree: BinaryTree, width: int = 4) -> WideTree:
    """The wide tree with the smallest sum of surface areas that consists of nodes of a binary one.

    A ray meets a node with a probability that is proportional to its surface area. Compared with opening the
    largest child again and again, this saves 2 % of the visits, and a fifth of the nodes: they have more children.
    """
    if tree.left[0] < 0:
        child = np.full((1, width), NO_CHILD, np.int32)
        child[0, 0] = child_leaf(tree.primitive[:1])[0]
        box = np.zeros((1, width, 6), np.float32)
        box[0, 0] = tree.box[0]
        return WideTree(child, box, 1)

    levels = adopt(tree, width)
    inner = [(members >= 0) & (tree.left[members] >= 0) for members in levels]
    places = depth_first(inner)
    count = sum(len(members) for members in levels)
    child = np.full((count, width), NO_CHILD, np.int32)
    box = np.zeros((count, width, 6), np.float32)
    for level, (members, parents, place) in enumerate(zip(levels, inner, places, strict=True)):
        rows = np.where(members >= 0, child_leaf(tree.primitive[members]), np.int32(NO_CHILD))
        if level + 1 < len(places):
            rows[parents] = places[level + 1]
        child[place] = rows
        box[place] = np.where(members[:, :, None] >= 0, tree.box[members], np.float32(0))
    return WideTree(child, box, len(levels))


def adopt(tree: BinaryTree, width: int) -> list[NDArray[np.int32]]:
    """For each level of the wide tree the binary nodes that become children: (nodes, W), -1 where there is none.

    The nodes of a level are the inner children of the level before, in the same order.
    """
    cost = slot_costs(tree, width)
    levels = []
    nodes = np.zeros(1, np.int32)
    while len(nodes):
        rows = np.arange(len(nodes))
        members = np.full((len(nodes), width), NO_CHILD, np.int32)
        slots = np.zeros((len(nodes), width), np.int32)
        members[:, 0], slots[:, 0] = nodes, width
        opens = np.zeros((len(nodes), width), np.bool_)
        opens[:, 0] = True
        for free in range(1, width):
            at = opens[:, :free].argmax(axis=1)
            rows = np.flatnonzero(opens[np.arange(len(nodes)), at])
            at = at[rows]
            left = tree.left[members[rows, at]]
            total = slots[rows, at]
            share = best_share(cost[left], cost[left + 1], total)
            for column, child, count in ((at, left, share), (free, left + 1, total - share)):
                members[rows, column], slots[rows, column] = child, count
                opens[rows, column] = cost[child, count - 1] < cost[child, 0]
        levels.append(members)
        nodes = members[(members >= 0) & (tree.left[members] >= 0)]
    return levels


def slot_costs(tree: BinaryTree, width: int) -> NDArray[np.float32]:
    """The least surface area below a parent if a subtree takes at most 1, 2 ... of its slots, (nodes, W - 1).

    In one slot stands the node itself, with the best of its own children; in more its descendants, shared out
    among left and right in the best way.
    """
    cost = np.repeat(half_area(tree.box)[:, None], width - 1, axis=1)
    for nodes in reversed(inner_levels(tree)):
        first = tree.left[nodes[0]]
        pairs = cost[first : first + 2 * len(nodes)].reshape(-1, 2, width - 1)
        left, right = pairs[:, 0], pairs[:, 1]
        own = np.empty((len(nodes), width - 1), np.float32)
        own[:, 0] = cost[nodes, 0] + shared_out(left, right, width)
        for slots in range(2, width):
            own[:, slots - 1] = np.minimum(own[:, slots - 2], shared_out(left, right, slots))
        cost[nodes] = own
    return cost


def shared_out(left: NDArray[np.float32], right: NDArray[np.float32], slots: int) -> NDArray[np.float32]:
    """The least cost of two subtrees that share `slots` slots, at least one each."""
    result = left[:, 0] + right[:, slots - 2]
    for share in range(2, slots):
        np.minimum(result, left[:, share - 1] + right[:, slots - share - 1], out=result)
    return result


def best_share(left: NDArray[np.float32], right: NDArray[np.float32], slots: NDArray[np.int32]) -> NDArray[np.int32]:
    """The number of slots of the left subtree at the least cost."""
    width = left.shape[1] + 1
    share = np.ones(len(slots), np.int32)
    best = np.full(len(slots), np.float32(np.inf))
    rows = np.arange(len(slots))
    for k in range(1, width):
        rest = np.maximum(slots - k, 1)
        cost = np.where(slots > k, left[:, k - 1] + right[rows, rest - 1], np.float32(np.inf))
        better = cost < best
        best[better], share[better] = cost[better], k
    return share


def inner_levels(tree: BinaryTree) -> list[NDArray[np.intp]]:
    """The inner nodes of each level of a binary tree."""
    result = []
    begin, end = 0, 1
    while begin < end:
        nodes = begin + np.flatnonzero(tree.left[begin:end] >= 0)
        if len(nodes):
            result.append(nodes)
        begin, end = end, end + 2 * len(nodes)
    return result


def depth_first(inner: list[NDArray[np.bool_]]) -> list[NDArray[np.int32]]:
    """The places of all nodes in depth-first order, per level. `inner` tells which children are nodes."""
    sizes: list[NDArray[np.int32]] = [np.zeros(0, np.int32)]
    for mask in reversed(inner):
        below = np.zeros(mask.shape, np.int32)
        below[mask] = sizes[-1]
        sizes.append(1 + below.sum(axis=1, dtype=np.int32))
    sizes.reverse()
    places: list[NDArray[np.int32]] = [np.zeros(1, np.int32)]
    for mask, below in zip(inner[:-1], sizes[1:], strict=False):
        size = np.zeros(mask.shape, np.int32)
        size[mask] = below
        first = np.cumsum(size, axis=1, dtype=np.int32) - size
        places.append((places[-1][:, None] + 1 + first)[mask])
    return places


# ---- quality -----------------------------------------------------------------------------------------------------


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


# ---- refit -------------------------------------------------------------------------------------------------------


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
