"""A kd-tree: space halved by planes across the axes, each leaf with a list of the triangles in it.

Planes are chosen by the surface area heuristic (I. Wald and V. Havran, "On building fast kd-Trees for
Ray Tracing, and on doing that in O(N log N)", 2006) among 15 per axis. Rays need no stack: from a leaf
without a hit they go back to the root, with their start moved to where they left the leaf (kd-restart:
T. Foley and J. Sugerman, "KD-Tree Acceleration Structures for a GPU Raytracer", 2005; M. Hapala and
V. Havran, "Review: Kd-tree Traversal Algorithms for Ray Tracing", 2011, compares the alternatives).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.geometry.accelerators.base import (
    NO_FACE,
    Approach,
    Found,
    SearchedTable,
    Statistics,
    TriangleTable,
    half_area,
)
from djpt.jit.kernels import as_vector, shared, while_loop, wide
from djpt.jit.types import ArrayXu, Bool, Float, UInt32

__all__ = ["KdTree"]

PLANES = 16
"""Intervals between candidate planes along an axis."""

EMPTY_BONUS = 0.8
"""Factor of the cost of planes that cut off empty space, whose gain the heuristic underestimates."""

MAX_REFERENCES = 12
"""Most references per triangle, on average."""

SMALL = 3
"""Nodes with at most so many triangles are leaves."""

CHUNK = 1 << 15
"""Nodes whose planes are compared at a time: bounds temporary memory."""

LEAF = 3
"""Marks a leaf, in place of a node's axis."""


@dataclass
class Nodes:
    """One level of the tree in the making."""

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    """The corners of the nodes' boxes, (nodes, 3)."""
    face: NDArray[np.int32]
    segment: NDArray[np.int32]
    """The node of each reference, whose triangle is in the array above; sorted by node."""

    def sizes(self) -> NDArray[np.int64]:
        """References per node."""
        return np.bincount(self.segment, minlength=len(self.low))


class KdTree(SearchedTable):
    """A kd-tree over triangles."""

    def __init__(self, corners: NDArray[np.float32]) -> None:
        start = time.perf_counter()
        self.table = TriangleTable(corners)
        low, high = self.table.low.min(axis=0), self.table.high.max(axis=0)
        self._low, self._high = as_vector(low), as_vector(high)
        words, faces, self.depth, self.cost = self._build(low, high)
        self.nodes, self.references = len(words), len(faces)
        self._words, self._faces = shared(words), shared(faces)
        self.seconds = time.perf_counter() - start

    # ---- building --------------------------------------------------------------------

    def _build(
        self, low: NDArray[np.float32], high: NDArray[np.float32]
    ) -> tuple[NDArray[np.uint32], NDArray[np.uint32], int, float]:
        """Build the tree: its nodes (two words each), the leaves' triangles, the number of levels, the SAH cost."""
        count = self.table.count
        everything = np.arange(count, dtype=np.int32)
        level = Nodes(low[None], high[None], everything, np.zeros(count, np.int32))
        deepest = int(8 + 1.3 * math.log2(count))
        words, leaves, first_item, cost = [], [], 0, 0.0
        next_node = 1
        for depth in range(deepest + 1):
            size, area = level.sizes(), half_area(level.low, level.high)
            axis, plane, at = choose(level, self.table)
            total = first_item + len(level.face)
            axis[(depth == deepest) | (total > MAX_REFERENCES * count)] = LEAF
            leaf = axis == LEAF
            cost += float(area.sum() + (area * size)[leaf].sum())
            finished = level.face[leaf[level.segment]]
            rows = np.empty((len(axis), 2), np.uint32)
            rows[leaf, 0] = size[leaf] * 4 + LEAF
            rows[leaf, 1] = first_item + np.cumsum(size[leaf]) - size[leaf]
            rows[~leaf, 0] = (next_node + 2 * np.arange((~leaf).sum())) * 4 + axis[~leaf]
            rows[~leaf, 1] = at[~leaf].view(np.uint32)
            words.append(rows)
            leaves.append(finished)
            first_item += len(finished)
            next_node += 2 * int((~leaf).sum())
            if leaf.all():
                break
            level = divide(level, self.table, axis, plane, at)
        return (
            np.concatenate(words),
            np.concatenate(leaves).astype(np.uint32),
            len(words),
            cost / float(half_area(low, high)),
        )

    # ---- queries ---------------------------------------------------------------------

    def search(self, ray: Approach, any_hit: bool) -> Found:
        enter, leave = ray.through(self._low, self._high)

        def visit(begin: Float, found: Found, active: Bool) -> tuple[Float, Found, Bool]:
            item, end, until = self._descend(ray, begin, leave)
            _, found = self.table.visit_list(ray, self._faces, item, end, found, any_hit)
            # A hit behind this leaf may lie behind one in the next.
            active = active & (found.t > until) & (until < leave)
            if any_hit:
                active &= found.face == NO_FACE
            return until, found, active

        _, found, _ = while_loop(
            (enter, ray.nothing_yet(), enter <= leave), lambda begin, found, active: active, visit, label="kd-tree"
        )
        result: Found = found
        return result

    def _node(self, index: UInt32) -> tuple[UInt32, UInt32]:
        words: Any = dr.gather(ArrayXu, self._words, index, shape=(2, 1))
        return words[0], words[1]

    def _descend(self, ray: Approach, begin: Float, leave: Float) -> tuple[UInt32, UInt32, Float]:
        """Descend from the root to the leaf at `begin`: its list (start, end), and where the ray leaves it."""

        def down(head: UInt32, tail: UInt32, until: Float) -> tuple[UInt32, UInt32, Float]:
            axis, left = head & 3, head >> 2
            o = dr.select(axis == 0, ray.o.x, dr.select(axis == 1, ray.o.y, ray.o.z))
            inv = dr.select(axis == 0, ray.inv.x, dr.select(axis == 1, ray.inv.y, ray.inv.z))
            plane: Any = dr.reinterpret_array(Float, tail)
            # Always rounded alike: the end of one leaf is exactly the start of the next.
            t = (plane - o) * inv
            beyond = t <= begin
            backwards = inv < 0
            until = dr.select(beyond, until, dr.minimum(until, t))
            head, tail = self._node(left + dr.select(beyond ^ backwards, UInt32(1), UInt32(0)))
            return head, tail, until

        def inner(head: UInt32, tail: UInt32, until: Float) -> Bool:
            return (head & 3) != LEAF

        root: tuple[UInt32, UInt32, Float] = wide((*self._node(UInt32(0)), leave), ray.lanes)
        head, tail, until = while_loop(root, inner, down, label="descent")
        return tail, tail + (head >> 2), until

    def statistics(self) -> Statistics:
        """Measure the tree's size and quality."""
        memory = 4 * (dr.width(self._words) + dr.width(self._faces) + dr.width(self.table.words))
        return Statistics(self.table.count, self.nodes, self.references, self.depth, self.cost, memory, self.seconds)


def interval(level: Nodes, table: TriangleTable, axis: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The first and last of a node's intervals along `axis` that each reference's triangle reaches into."""
    node = level.segment
    low = level.low[:, axis]
    extent = level.high[:, axis] - low
    scale = np.where(extent > 0, PLANES / np.where(extent > 0, extent, 1), 0).astype(np.float32)
    first, last = (
        np.clip((bound[level.face, axis] - low[node]) * scale[node], 0, PLANES - 1).astype(np.int32)
        for bound in (table.low, table.high)
    )
    return first, last


def choose(level: Nodes, table: TriangleTable) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """The best plane of each node: its axis (LEAF if no plane pays), its number, its coordinate."""
    count = len(level.low)
    size = level.sizes()
    extent = (level.high - level.low).astype(np.float64)
    area = half_area(level.low, level.high)
    best = size.astype(np.float64)
    axis, plane = np.full(count, LEAF), np.zeros(count, np.int64)
    for a in range(3):
        first, last = interval(level, table, a)
        value, number = cheapest(level, first, last, size, extent, area, a)
        # Rounding must not put the plane onto a side of the node, where it would cut nothing off.
        at = position(level, a, number)
        pays = (value < best) & (at > level.low[:, a]) & (at < level.high[:, a]) & (size > SMALL)
        best[pays], axis[pays], plane[pays] = value[pays], a, number[pays]
    at = np.zeros(count, np.float32)
    for a in range(3):
        at[axis == a] = position(level, a, plane)[axis == a]
    return axis, plane, at


def position(level: Nodes, axis: int, plane: NDArray[np.int64]) -> NDArray[np.float32]:
    """The coordinates of planes, given by number."""
    low = level.low[:, axis]
    return low + (level.high[:, axis] - low) * (plane.astype(np.float32) / np.float32(PLANES))


def cheapest(
    level: Nodes,
    first: NDArray[np.int32],
    last: NDArray[np.int32],
    size: NDArray[np.int64],
    extent: NDArray[np.float64],
    area: NDArray[np.float64],
    axis: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Cost and number of each node's best plane across an axis: 1 + (A(left) n(left) + A(right) n(right)) / A."""
    count = len(size)
    b, c = (extent[:, (axis + k) % 3] for k in (1, 2))
    along, across = (extent[:, axis] * (b + c))[:, None], (b * c)[:, None]
    share = np.arange(1, PLANES) / PLANES
    value, number = np.empty(count), np.empty(count, np.int64)
    bounds = np.concatenate([[0], np.cumsum(size)])
    for begin in range(0, count, CHUNK):
        end = min(begin + CHUNK, count)
        references = slice(bounds[begin], bounds[end])
        bins = (level.segment[references] - begin) * PLANES
        starts, ends = (
            np.bincount(bins + x[references], minlength=(end - begin) * PLANES).reshape(-1, PLANES)
            for x in (first, last)
        )
        left = np.cumsum(starts, axis=1)[:, :-1]
        right = size[begin:end, None] - np.cumsum(ends, axis=1)[:, :-1]
        part = slice(begin, end)
        weighted = along[part] * (share * left + (1 - share) * right) + across[part] * (left + right)
        with np.errstate(divide="ignore", invalid="ignore"):
            cost = 1 + weighted / area[part, None]
        cost = np.where((left == 0) | (right == 0), EMPTY_BONUS * cost, cost)
        best = np.nan_to_num(cost, nan=np.inf).argmin(axis=1)
        value[part] = cost[np.arange(end - begin), best]
        number[part] = best + 1
    return value, number


def divide(
    level: Nodes,
    table: TriangleTable,
    axis: NDArray[np.int64],
    plane: NDArray[np.int64],
    at: NDArray[np.float32],
) -> Nodes:
    """The children of all nodes that aren't leaves; triangles that a plane cuts go to both."""
    inner = axis != LEAF
    number = np.cumsum(inner) - 1
    goes_left, goes_right = (np.zeros(len(level.face), np.bool_) for _ in range(2))
    for a in range(3):
        first, last = interval(level, table, a)
        own, cut = axis[level.segment] == a, plane[level.segment]
        goes_left |= own & (first < cut)
        goes_right |= own & (last >= cut)
    child = 2 * number[level.segment]
    face = np.concatenate([level.face[goes_left], level.face[goes_right]])
    segment = np.concatenate([child[goes_left], child[goes_right] + 1]).astype(np.int32)
    order = np.argsort(segment, kind="stable")
    low, high = np.repeat(level.low[inner], 2, axis=0), np.repeat(level.high[inner], 2, axis=0)
    rows = np.arange(int(inner.sum()))
    high[2 * rows, axis[inner]] = at[inner]
    low[2 * rows + 1, axis[inner]] = at[inner]
    return Nodes(low, high, face[order], segment[order])
