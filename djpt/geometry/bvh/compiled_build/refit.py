"""The fit of a tree's boxes and leaves to its primitives: after the build, and whenever they have moved.

Nodes are fitted from the last to the first, in chunks: below a node lie those that follow it. The few whose
descendants reach into another chunk come at the end.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.compiled_build.collapse_functions import LEAF_COST, NODE_COST
from djpt.geometry.bvh.compiled_build.functions import functions
from djpt.geometry.bvh.compiled_build.workers import Workers, workers
from djpt.geometry.bvh.extent import Extent
from djpt.geometry.bvh.steps.records import SLACK

__all__ = ["NO_BOXES", "TRIANGLES", "Built", "chunks", "extent_of", "fit", "floats", "refit"]

CHUNK = 1024
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
    """The nodes that a random line through the root's box meets on average; see `djpt.geometry.bvh.statistics`."""
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

    The arguments are those of `djpt.geometry.bvh.compiled_build.builder.build`, with the numbers of primitives
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
    slack = SLACK * max(extent.diagonal, 1e-30)
    numbers = np.array([*extent.center, slack, extent.scale], np.float32)
    parts = chunks(built.nodes, CHUNK)
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
