"""A binary tree made wide: fewer, larger nodes are fewer steps of a ray.

Wald, Benthin, Boulos, "Getting Rid of Packets" (2008); Dammertz, Hanika, Keller, "Shallow Bounding
Volume Hierarchies" (2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.tree import BinaryTree, half_area

__all__ = ["NO_CHILD", "WideTree", "child_leaf", "collapse"]

NO_CHILD = -1


@dataclass
class WideTree:
    """A tree of K nodes with up to W children each; node 0 is the root.

    Nodes stand in depth-first order: what a ray visits in turn is near in memory, and children come
    after their parents.
    """

    child: NDArray[np.int32]
    """(K, W): >= 0 a node, -1 none (those come last), <= -2 the primitive -2 - child."""
    box: NDArray[np.float32]
    """(K, W, 6): low xyz, high xyz of each child; zeros where there is none."""
    depth: int
    """Levels of nodes."""


def child_leaf(primitive: NDArray[np.int32]) -> NDArray[np.int32]:
    """How `WideTree.child` refers to a primitive; its own inverse."""
    return -2 - primitive


def collapse(tree: BinaryTree, width: int = 4) -> WideTree:
    """Let nodes adopt their grandchildren, those of the child with the largest surface first.

    A ray that visits a node visits a child with the probability of their areas' ratio, so the largest
    child is the one that it pays most to skip.
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
    """Per level of the wide tree the binary nodes that become children: (nodes, W), -1 where there is none.

    The nodes of a level are the inner children of the level before, in the same order.
    """
    # Leaves can't be opened.
    priority = np.where(tree.left >= 0, half_area(tree.box), np.float32(-1))
    levels = []
    nodes = np.zeros(1, np.int32)
    while len(nodes):
        members = np.full((len(nodes), width), NO_CHILD, np.int32)
        members[:, 0] = tree.left[nodes]
        members[:, 1] = members[:, 0] + 1
        value = np.full((len(nodes), width), np.float32(-1))
        value[:, :2] = priority[members[:, :2]]
        for free in range(2, width):
            slot = value[:, :free].argmax(axis=1)
            rows = np.flatnonzero(value[np.arange(len(nodes)), slot] >= 0)
            slot = slot[rows]
            left = tree.left[members[rows, slot]]
            members[rows, slot], members[rows, free] = left, left + 1
            value[rows, slot], value[rows, free] = priority[left], priority[left + 1]
        levels.append(members)
        nodes = members[value >= 0]
    return levels


def depth_first(inner: list[NDArray[np.bool_]]) -> list[NDArray[np.int32]]:
    """The places of all nodes in depth-first order, per level. `inner`: which children are nodes."""
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
