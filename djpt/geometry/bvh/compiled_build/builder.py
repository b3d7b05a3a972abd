"""The build of a tree: what its threads do, and in which memory.

The tree is the same for every number of threads: nodes are split on their own, and each has places for the
nodes below it that depend on nothing but the sizes of those to its left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.calls.layout import CHILDREN, LEAF_ROWS, NODE_ROWS, ROOT, ROW_WORDS
from djpt.geometry.bvh.compiled_build.binary_nodes import ALONE, BIAS, NODE_SIZE, PRIMITIVE_SIZE
from djpt.geometry.bvh.compiled_build.functions import functions
from djpt.geometry.bvh.compiled_build.refit import NO_BOXES, TRIANGLES, Built, chunks, extent_of, fit, floats
from djpt.geometry.bvh.compiled_build.workers import Workers, workers
from djpt.jit.kernels import aligned

__all__ = ["DEEPEST", "build"]

DEEPEST = 60
"""The most levels of a tree."""

GRAIN, TASKS = 4096, 32
"""Subtrees of at most so many primitives, or of that share of all, are built by one task."""

CHUNK = 4096
"""Wide nodes whose references one task writes."""


def build(
    corners: NDArray[np.float32], placed_boxes: NDArray[np.float32] | None = None, threads: int | None = None
) -> Built:
    """Build a tree over triangles with some corners (F, 3, 3), and over primitives in boxes (P, 6), F + P >= 1.

    Boxes: low xyz, high xyz. Placed primitives are alone in their leaves. `threads`: as many as Dr.Jit has if None.
    """
    corners, placed = floats(corners), NO_BOXES if placed_boxes is None else floats(placed_boxes)
    with workers(len(corners) + len(placed), threads) as team:
        construction = Construction(corners, placed, team)
        construction.grow()
        plan = construction.plan()
        extent = construction.extent
        del construction
        built = plan.emit(len(corners), team)
        fit(built, extent, corners, placed, team)
    return built


class Construction:
    """The primitives and the binary nodes of a tree that is being built."""

    def __init__(self, corners: NDArray[np.float32], placed: NDArray[np.float32], team: Workers) -> None:
        self._count, self._team = len(corners) + len(placed), team
        self._even, self._odd = (np.empty((self._count, PRIMITIVE_SIZE // 4), np.float32) for _ in range(2))
        # The root is the last of the nodes.
        self._nodes = np.empty((2 * self._count - 1, NODE_SIZE // 4), np.float32)
        self._sorted = np.empty(self._count, np.uint32)
        self._split: list[int] = []
        self._pairs: list[int] = []
        self._prepare(corners, placed)
        deepest = min(2 * math.ceil(math.log2(self._count)) + 12, DEEPEST)
        arrays = (self._nodes, self._even, self._odd, self._sorted)
        self._state = (*(array.ctypes.data for array in arrays), deepest)

    def _prepare(self, corners: NDArray[np.float32], placed: NDArray[np.float32]) -> None:
        """Write the records of all primitives and the root."""
        parts = chunks(len(corners), TRIANGLES)
        bounds = np.empty((len(parts), 16), np.float32)
        source, target = corners.ctypes.data, self._even.ctypes.data
        self._team.map(
            lambda k: functions().prepare(source, *parts[k], target, bounds[k:].ctypes.data), range(len(parts))
        )
        self.extent = extent_of(bounds, placed)
        centroids = placed[:, :3] + placed[:, 3:]
        low, high = (
            combine(np.concatenate([part, centroids]), axis=0)
            for combine, part in ((np.min, bounds[:, 8:11]), (np.max, bounds[:, 12:15]))
        )
        records = self._even[len(corners) :]
        records[:, :3], records[:, 4:7], records[:, 7] = placed[:, :3], -placed[:, 3:], ALONE
        records[:, 3] = (np.arange(len(placed), dtype=np.uint32) + BIAS).view(np.float32)
        stored = np.array([0, self._count, 0, 0], np.uint32) + BIAS
        rows = [self.extent.low, -self.extent.high, low, high]
        self._nodes[-1] = np.concatenate([np.append(r, w) for r, w in zip(rows, stored.view(np.float32), strict=True)])

    def grow(self) -> None:
        """Build the binary tree, and weigh its nodes."""
        self._grain = max(self._count // TASKS, GRAIN)
        self._team.begin(self._grow, (2 * self._count - 2, 0))
        self._team.finish()
        nodes, scale = self._nodes.ctypes.data, self.extent.scale
        # Parents were split before their children.
        for node in reversed(self._split):
            functions().weigh(nodes, node, node + 1, scale)

    def _grow(self, task: tuple[int, int]) -> None:
        """Build all below a node, in the nodes from `free` on.

        A node with n primitives has 2 (n - 1) descendants at most: room for its children, then for all below the left
        one, then for all below the right one.
        """
        node, free = task
        while self._size(node) > self._grain and functions().split(*self._state, node, free):
            self._split.append(node)
            right = free + 2 * self._size(free)
            self._team.begin(self._grow, (free + 1, right))
            node, free = free, free + 2
        end = functions().grow(*self._state, node, free)
        nodes = self._nodes.ctypes.data
        functions().weigh(nodes, free, end, self.extent.scale)
        functions().weigh(nodes, node, node + 1, self.extent.scale)
        self._pairs.append((end - free) // 2)

    def _size(self, node: int) -> int:
        """The primitives of a node that hasn't been split."""
        return int(self._nodes[node].view(np.uint32)[7]) - BIAS

    def plan(self) -> Plan:
        """Choose the nodes of the wide tree."""
        leaves = 1 + len(self._split) + sum(self._pairs)
        # A wide node has two children at least, unless it is the only one.
        references = np.empty((leaves + 1, CHILDREN), np.uint32)
        ends, starts, places = (np.empty(leaves + 1, np.uint32) for _ in range(3))
        counts = np.empty(2, np.int64)
        arrays = (references, ends, starts, places, counts)
        nodes = functions().plan(self._nodes.ctypes.data, 2 * self._count - 2, *(array.ctypes.data for array in arrays))
        return Plan(references[1:], ends[:nodes].copy(), starts, places, self._sorted, nodes, *counts.tolist())


@dataclass
class Plan:
    """The nodes of a wide tree before they have a place in memory."""

    references: NDArray[np.uint32]
    """The references of all nodes to their children, where leaves have a number instead of a place."""
    ends: NDArray[np.uint32]
    starts: NDArray[np.uint32]
    """The first place of each leaf in `sorted`."""
    places: NDArray[np.uint32]
    """The first place of each leaf in the order of the leaves, and the end."""
    sorted: NDArray[np.uint32]
    """The triangles in the order of the binary tree."""
    nodes: int
    leaves: int
    depth: int

    def emit(self, triangles: int, team: Workers) -> Built:
        """Write what stays when primitives move."""
        memory = aligned((ROW_WORDS * (ROOT + NODE_ROWS * self.nodes + LEAF_ROWS * self.leaves),))
        order = np.empty(triangles, np.uint32)
        arrays = (self.references, self.starts, self.places, self.sorted, memory, order)
        addresses = [array.ctypes.data for array in arrays]
        team.map(lambda part: functions().emit(*addresses, self.nodes, *part), chunks(self.nodes, CHUNK))
        return Built(memory, self.nodes, self.leaves, order, self.depth, self.ends)
