"""The build of a tree by threads: which ranges of numbers they work on, and in which memory; its fit, also later.

The tree is the same for every number of threads: nodes are split on their own, and each has places for the
nodes below it that depend on nothing but the sizes of those to its left.

Boxes and leaves are fitted from the last node to the first, in chunks: below a node lie those that follow it. The few
nodes whose descendants reach into another chunk come at the end. That is all there is to do when primitives have moved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.build.build_functions import ALONE, BIAS, NODE_SIZE, PRIMITIVE_SIZE
from djpt.geometry.bvh.build.collapse_functions import LEAF_COST, NODE_COST
from djpt.geometry.bvh.build.functions import functions
from djpt.geometry.bvh.calls.layout import CHILDREN, LEAF_ROWS, NODE_ROWS, ROOT, ROW_WORDS
from djpt.geometry.bvh.leaves import Extent
from djpt.jit.kernels import aligned

__all__ = ["DEEPEST", "Built", "Workers", "binary_nodes", "build", "chunks", "floats", "refit", "workers"]

DEEPEST = 60
"""The most levels of a tree."""

GRAIN, TASKS = 4096, 32
"""Subtrees of at most so many primitives, or of that fraction of all, are built by one task."""

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


def binary_nodes(boxes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Build a binary tree over primitives in boxes (N, 6), each alone in a leaf.

    Returns its nodes, (2N - 1, 16), the root last; `djpt.geometry.bvh.build.build_functions.NODE_SIZE` says what is in
    them.
    """
    with workers(len(boxes), None) as team:
        construction = Construction(np.zeros((0, 3, 3), np.float32), floats(boxes), team)
        construction.grow()
    return construction.nodes


class Construction:
    """The primitives and the binary nodes of a tree that is being built."""

    def __init__(self, corners: NDArray[np.float32], placed: NDArray[np.float32], team: Workers) -> None:
        self._count, self._team = len(corners) + len(placed), team
        self._even, self._odd = (np.empty((self._count, PRIMITIVE_SIZE // 4), np.float32) for _ in range(2))
        # The root is the last of the nodes.
        self.nodes = np.empty((2 * self._count - 1, NODE_SIZE // 4), np.float32)
        self._sorted = np.empty(self._count, np.uint32)
        self._split: list[int] = []
        self._pairs: list[int] = []
        self._prepare(corners, placed)
        deepest = min(2 * math.ceil(math.log2(self._count)) + 12, DEEPEST)
        arrays = (self.nodes, self._even, self._odd, self._sorted)
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
        self.nodes[-1] = np.concatenate([np.append(r, w) for r, w in zip(rows, stored.view(np.float32), strict=True)])

    def grow(self) -> None:
        """Build the binary tree, and weigh its nodes."""
        self._grain = max(self._count // TASKS, GRAIN)
        self._team.begin(self._grow, (2 * self._count - 2, 0))
        self._team.finish()
        nodes, scale = self.nodes.ctypes.data, self.extent.scale
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
        nodes = self.nodes.ctypes.data
        functions().weigh(nodes, free, end, self.extent.scale)
        functions().weigh(nodes, node, node + 1, self.extent.scale)
        self._pairs.append((end - free) // 2)

    def _size(self, node: int) -> int:
        """The primitives of a node that hasn't been split."""
        return int(self.nodes[node].view(np.uint32)[7]) - BIAS

    def plan(self) -> Plan:
        """Choose the nodes of the wide tree."""
        leaves = 1 + len(self._split) + sum(self._pairs)
        # A wide node has two children at least, unless it is the only one.
        references = np.empty((leaves + 1, CHILDREN), np.uint32)
        ends, starts, places = (np.empty(leaves + 1, np.uint32) for _ in range(3))
        counts = np.empty(2, np.int64)
        arrays = (references, ends, starts, places, counts)
        nodes = functions().plan(self.nodes.ctypes.data, 2 * self._count - 2, *(array.ctypes.data for array in arrays))
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


# ---- fit ---------------------------------------------------------------------------------------------------------


FIT_CHUNK = 1024
"""Nodes that one task fits."""

TRIANGLES = 1 << 16
"""Triangles of one task that reads all corners."""

NO_BOXES = np.zeros((0, 6), np.float32)


@dataclass
class Built:
    """A tree with eight children per node in its memory."""

    memory: NDArray[np.uint32]
    """Eight words per row: a header for the caller, the nodes from row 8 on, each after its parent, the leaves."""
    nodes: int
    leaves: int
    order: NDArray[np.uint32]
    """The triangles in the order of the leaves."""
    depth: int
    """Levels of nodes."""
    ends: NDArray[np.uint32]
    """For each node, the number of the first one after it that isn't below it."""
    extent: Extent = field(default_factory=lambda: Extent(np.zeros(3, np.float32), np.zeros(3, np.float32)))
    """The box about everything; its middle is the origin of all coordinates in the tree."""
    node_visits: float = 0.0
    """The nodes that a random line through the root's box meets on average; see `djpt.geometry.bvh.build.wide`."""
    leaf_visits: float = 0.0
    """The leaves that it meets, placed primitives included."""

    @property
    def sah_cost(self) -> float:
        """The cost of such a line by the surface area heuristic; 0 for trees without surface."""
        return NODE_COST * self.node_visits + LEAF_COST * self.leaf_visits


def refit(
    built: Built,
    corners: NDArray[np.float32],
    placed_boxes: NDArray[np.float32] | None = None,
    threads: int | None = None,
) -> float:
    """Fit a tree to its triangles and placed primitives where they are now, in place; return the new SAH cost.

    The arguments are those of `djpt.geometry.bvh.build.builder.build`, with the numbers of primitives
    unchanged.
    """
    corners, placed = floats(corners), NO_BOXES if placed_boxes is None else floats(placed_boxes)
    parts = chunks(len(corners), TRIANGLES)
    partial = np.empty((len(parts), 16), np.float32)
    with workers(len(corners), threads) as team:
        team.map(
            lambda k: functions().bounds(corners.ctypes.data, *parts[k], None, partial[k:].ctypes.data),
            range(len(parts)),
        )
        fit(built, extent_of(partial, placed), corners, placed, team)
    return built.sah_cost


def fit(built: Built, extent: Extent, corners: NDArray[np.float32], placed: NDArray[np.float32], team: Workers) -> None:
    """Write all corners and boxes of a tree."""
    built.extent = extent
    numbers = np.array([*extent.center, extent.slack, extent.scale], np.float32)
    parts = chunks(built.nodes, FIT_CHUNK)
    crossing = crossing_nodes(built.ends, parts)
    sums = np.zeros((len(parts) + 1, 2), np.float64)
    arrays = (built.memory, corners, built.order, placed, numbers, built.ends)
    addresses = [array.ctypes.data for array in arrays]

    def fit_chunk(k: int) -> None:
        first, end = parts[k]
        functions().fit(*addresses, first, end, end, sums[k:].ctypes.data)

    team.map(fit_chunk, range(len(parts)))
    for node in reversed(crossing.tolist()):
        functions().fit(*addresses, node, node + 1, built.nodes, sums[-1:].ctypes.data)
    areas = sums.sum(axis=0) / extent.area if extent.area > 0 else np.zeros(2)
    built.node_visits = float(1 + areas[0]) if extent.area > 0 else 0.0
    built.leaf_visits = float(areas[1])


def extent_of(partial: NDArray[np.float32], placed: NDArray[np.float32]) -> Extent:
    """The extent of triangles, as `bounds` gives it for parts of them, and of placed boxes."""
    low = np.concatenate([partial[:, 0:3], placed[:, :3]]).min(axis=0)
    return Extent(low, np.concatenate([-partial[:, 4:7], placed[:, 3:]]).max(axis=0))


def floats(array: NDArray[np.float32]) -> NDArray[np.float32]:
    """An array as functions that know only its address take it; a copy if need be."""
    return np.ascontiguousarray(array, np.float32)


def chunks(count: int, size: int) -> list[tuple[int, int]]:
    """Parts of the numbers below `count`: the first, and the end of each."""
    return [(first, min(first + size, count)) for first in range(0, count, size)]


def crossing_nodes(ends: NDArray[np.uint32], parts: list[tuple[int, int]]) -> NDArray[np.intp]:
    """The nodes that have others below them in a later chunk."""
    ends_of_parts = np.repeat([end for _, end in parts], [end - first for first, end in parts])
    return np.flatnonzero(ends > ends_of_parts)


# ---- threads -----------------------------------------------------------------------------------------------------


T = TypeVar("T")
R = TypeVar("R")

FEW = 20_000
"""With fewer primitives, threads aren't worth their start."""


class Workers:
    """Threads that work through lists of tasks; or just the calling one."""

    def __init__(self, pool: ThreadPoolExecutor | None) -> None:
        self._pool = pool
        self._futures: list[Future[None]] = []

    def map(self, function: Callable[[T], R], tasks: Sequence[T]) -> list[R]:
        """The results of a function for all tasks."""
        if self._pool is None or len(tasks) < 2:
            return [function(task) for task in tasks]
        return list(self._pool.map(function, tasks))

    def begin(self, function: Callable[[T], None], task: T) -> None:
        """Do a task soon, which may begin others."""
        if self._pool is None:
            function(task)
        else:
            self._futures.append(self._pool.submit(function, task))

    def finish(self) -> None:
        """Wait for all tasks that were begun."""
        # A task that begins another one does so before it ends: the list is complete when its end is reached.
        for future in self._futures:
            future.result()
        self._futures.clear()


@contextmanager
def workers(primitives: int, threads: int | None) -> Iterator[Workers]:
    """Threads for a tree over some primitives: as many as Dr.Jit has, unless a number is given."""
    count = dr.thread_count() if threads is None else threads
    if primitives < FEW or count < 2:
        yield Workers(None)
    else:
        with ThreadPoolExecutor(count) as pool:
            yield Workers(pool)
