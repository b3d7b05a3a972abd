"""An octree: boxes cut into eight equal parts, again and again where there are many triangles.

A. Glassner, "Space subdivision for fast ray tracing", 1984. As there, a ray needs no stack: it looks up the leaf at its
start, and where it leaves this leaf without a hit, it looks up the next, from the root.
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

__all__ = ["Octree", "overlap"]

ENOUGH = 6
"""Boxes with at most so many triangles are leaves."""

MAX_REFERENCES = 16
"""Most references per triangle, on average."""

CHUNK = 1 << 18
"""Pairs of a triangle and a box that are tested at a time: bounds temporary memory."""

LEAF, INNER = 0, 1
"""The lowest bit of a node's first word."""


@dataclass
class Level:
    """One level of the tree in the making."""

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    """The corners of the nodes' boxes, (nodes, 3)."""
    face: NDArray[np.int32]
    node: NDArray[np.int32]
    """The node of each reference, whose triangle is in the array above; sorted by node."""


class Octree(SearchedTable):
    """An octree over triangles. Its boxes have the proportions of the scene's."""

    def __init__(self, corners: NDArray[np.float32]) -> None:
        start = time.perf_counter()
        self.table = TriangleTable(corners)
        self.low: NDArray[np.float32] = self.table.low.min(axis=0)
        self.high: NDArray[np.float32] = self.table.high.max(axis=0)
        self._low, self._high = as_vector(self.low), as_vector(self.high)
        words, faces = self._build((corners - self.table.center.numpy().ravel()).astype(np.float64))
        self.nodes, self.references = len(words), len(faces)
        self._words, self._faces = shared(words), shared(faces)
        self.seconds = time.perf_counter() - start

    # ---- building --------------------------------------------------------------------

    def _build(self, corners: NDArray[np.float64]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        """Build the tree, level by level: its nodes (four words each), and the leaves' triangles.

        A leaf is the number of its triangles and the place of the first, an inner node the number of the first of its
        eight children and the coordinates of the point in which they meet.
        """
        count = self.table.count
        everything = np.arange(count, dtype=np.int32)
        level = Level(self.low[None], self.high[None], everything, np.zeros(count, np.int32))
        # Triangles may meet in one point: no cut separates them.
        deepest = 4 + math.ceil(0.6 * math.log2(count))
        words, leaves, first_item, next_node = [], [], 0, 1
        self.depth, self.cost = 0, 0.0
        whole = float(half_area(self.low, self.high))
        while len(level.low):
            size = np.bincount(level.node, minlength=len(level.low))
            full = first_item + len(level.face) > MAX_REFERENCES * count
            inner = (size > ENOUGH) & (self.depth < deepest) & (not full)
            middle = 0.5 * level.low + 0.5 * level.high
            # Rounding must not put the planes onto a side of the box, where they would cut nothing off.
            inner &= ((middle > level.low) & (middle < level.high)).all(axis=1)
            area = half_area(level.low, level.high) / whole
            self.cost += float(area.sum() + (area * size)[~inner].sum())
            rows = np.zeros((len(size), 4), np.uint32)
            rows[~inner, 0] = 2 * size[~inner] + LEAF
            rows[~inner, 1] = first_item + np.cumsum(size[~inner]) - size[~inner]
            rows[inner, 0] = 2 * (next_node + 8 * np.arange(inner.sum())) + INNER
            rows[inner, 1:] = middle[inner].view(np.uint32)
            words.append(rows)
            leaves.append(level.face[~inner[level.node]])
            first_item += len(leaves[-1])
            next_node += 8 * int(inner.sum())
            self.depth += 1
            level = self._divide(level, inner, middle, corners)
        return np.concatenate(words), np.concatenate(leaves).astype(np.uint32)

    def _divide(
        self, level: Level, inner: NDArray[np.bool_], middle: NDArray[np.float32], corners: NDArray[np.float64]
    ) -> Level:
        """The eight parts of each inner node, and the triangles in them. Bit a of a part: above the plane across a."""
        number = np.cumsum(inner) - 1
        kept = inner[level.node]
        face, parent = level.face[kept], level.node[kept]
        slack = float(self.table.slack)
        lows, highs, faces, nodes = [], [], [], []
        for part in range(8):
            above = np.array([part >> a & 1 for a in range(3)], np.bool_)
            low, high = np.where(above, middle, level.low), np.where(above, level.high, middle)
            lows.append(low[inner])
            highs.append(high[inner])
            bounds = ((self.table.low[face] <= high[parent]) & (self.table.high[face] >= low[parent])).all(axis=1)
            near = np.flatnonzero(bounds)
            touches = np.zeros(len(face), np.bool_)
            for begin in range(0, len(near), CHUNK):
                some = near[begin : begin + CHUNK]
                touches[some] = overlap(corners[face[some]], low[parent[some]], high[parent[some]], slack)
            faces.append(face[touches])
            nodes.append(8 * number[parent[touches]] + part)
        node = np.concatenate(nodes).astype(np.int32)
        order = np.argsort(node, kind="stable")
        low, high = (np.stack(x, axis=1).reshape(-1, 3) for x in (lows, highs))
        return Level(low, high, np.concatenate(faces)[order], node[order])

    # ---- queries ---------------------------------------------------------------------

    def search(self, ray: Approach, any_hit: bool) -> Found:
        enter, leave = ray.through(self._low, self._high)

        def visit(begin: Float, found: Found, active: Bool) -> tuple[Float, Found, Bool]:
            item, end, until = self._leaf_at(ray, begin, leave)
            _, found = self.table.visit_list(ray, self._faces, item, end, found, any_hit)
            # A hit behind this leaf may lie behind one in the next.
            active = active & (found.t > until) & (until < leave)
            if any_hit:
                active &= found.face == NO_FACE
            return until, found, active

        _, found, _ = while_loop(
            (enter, ray.nothing_yet(), enter <= leave), lambda begin, found, active: active, visit, label="octree"
        )
        result: Found = found
        return result

    def _leaf_at(self, ray: Approach, begin: Float, leave: Float) -> tuple[UInt32, UInt32, Float]:
        """Descend from the root to the leaf at the distance `begin`: its list (start, end), and its end."""

        def node(index: UInt32) -> list[UInt32]:
            words: Any = dr.gather(ArrayXu, self._words, index, shape=(4, 1))
            return list(words)

        def down(words: list[UInt32], until: Float) -> tuple[list[UInt32], Float]:
            part = UInt32(0)
            for a in range(3):
                plane: Any = dr.reinterpret_array(Float, words[1 + a])
                # Always rounded alike: the end of one leaf is exactly the start of the next.
                t = (plane - ray.o[a]) * ray.inv[a]
                beyond = t <= begin
                until = dr.select(beyond, until, dr.minimum(until, t))
                part |= dr.select(beyond ^ (ray.inv[a] < 0), UInt32(1 << a), UInt32(0))
            return node((words[0] >> 1) + part), until

        def inner(words: list[UInt32], until: Float) -> Bool:
            return (words[0] & 1) == INNER

        words, until = while_loop(wide((node(UInt32(0)), leave), ray.lanes), inner, down, label="leaf")
        return words[1], words[1] + (words[0] >> 1), until

    def statistics(self) -> Statistics:
        """Measure the tree's size and quality."""
        memory = 4 * (dr.width(self._words) + dr.width(self._faces) + dr.width(self.table.words))
        return Statistics(self.table.count, self.nodes, self.references, self.depth, self.cost, memory, self.seconds)

    def leaves(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint32]]]:
        """The leaves: two corners of the box, relative to the middle of all triangles, and the faces in it."""
        words, faces = self._words.numpy().reshape(-1, 4), self._faces.numpy()
        found, waiting = [], [(0, self.low, self.high)]
        while waiting:
            node, low, high = waiting.pop()
            head, first = (int(word) for word in words[node, :2])
            if head & 1 == LEAF:
                found.append((low, high, faces[first : first + head // 2]))
                continue
            middle = words[node, 1:].view(np.float32)
            for part in range(8):
                above = np.array([part >> a & 1 for a in range(3)], np.bool_)
                waiting.append((head // 2 + part, np.where(above, middle, low), np.where(above, high, middle)))
        return found


def overlap(
    corners: NDArray[np.float64], low: NDArray[np.float32], high: NDArray[np.float32], slack: float
) -> NDArray[np.bool_]:
    """Whether triangles (N, 3, 3) come within `slack` of boxes, by the axes that could separate them.

    T. Akenine-Moeller, "Fast 3D triangle-box overlap testing", 2001: two convex bodies are disjoint if their
    projections on some axis are, and here thirteen axes are enough: those of the box, the normal, and the products of
    edges. The boxes' own axes are left to comparisons of bounds.
    """
    half = 0.5 * (high.astype(np.float64) - low) + slack
    p = corners - 0.5 * (high.astype(np.float64) + low)[:, None]
    edges = np.roll(p, -1, axis=1) - p
    axes = [np.cross(edges[:, 0], edges[:, 1])]
    for edge in range(3):
        x, y, z = edges[:, edge].T
        none = np.zeros_like(x)
        axes += [np.stack(axis, axis=1) for axis in ((none, -z, y), (z, none, -x), (-y, x, none))]
    apart = np.zeros(len(p), np.bool_)
    for axis in axes:
        along = np.einsum("nca,na->nc", p, axis)
        reach = (half * np.abs(axis)).sum(axis=1)
        apart |= (along.min(axis=1) > reach) | (along.max(axis=1) < -reach)
    return ~apart
