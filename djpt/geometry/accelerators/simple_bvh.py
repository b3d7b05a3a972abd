"""A BVH by the simplest rules: halve the triangles along the longest axis until five are left.

T. Kay and J. Kajiya, "Ray tracing complex scenes", 1986, halve by number; the walk without a stack is B. Smits's,
"Efficiency issues for ray tracing", 1998: nodes are stored depth first, and each knows where to go on if its box is
missed. Boxes are visited in one order for all rays. `djpt.geometry.bvh` shows what better rules gain.
"""

from __future__ import annotations

import time
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
from djpt.jit.kernels import maximum, minimum, shared, while_loop, wide
from djpt.jit.types import ArrayXu, Bool, Float, UInt32, Vector3f

__all__ = ["SimpleBvh"]

ENOUGH = 5
"""Nodes with at most so many triangles are leaves."""


class SimpleBvh(SearchedTable):
    """A bounding volume hierarchy: longest axis, median, at most five triangles in a leaf."""

    def __init__(self, corners: NDArray[np.float32]) -> None:
        start = time.perf_counter()
        self.table = TriangleTable(corners)
        self._centers = self.table.low + self.table.high
        self._boxes: list[NDArray[np.float32]] = []
        self._links: list[tuple[int, int, int]] = []
        self._order: list[NDArray[np.int64]] = []
        self.depth = 0
        self._grow(np.arange(self.table.count), 0, 1)
        words = np.concatenate([np.array(self._boxes).view(np.uint32), np.array(self._links, np.uint32)], axis=1)
        words = np.pad(words, ((0, 0), (0, 7)))
        self.nodes = len(words)
        self._words, self._faces = shared(words), shared(np.concatenate(self._order).astype(np.uint32))
        self.seconds = time.perf_counter() - start

    def _grow(self, faces: NDArray[np.int64], first: int, depth: int) -> None:
        """Add the node of some triangles, whose place in the order of all is `first`, and the nodes below it."""
        low, high = self.table.low[faces].min(axis=0), self.table.high[faces].max(axis=0)
        node, leaf = len(self._boxes), len(faces) <= ENOUGH
        self._boxes.append(np.concatenate([low, high]))
        self._links.append((0, 0, 0))
        self.depth = max(self.depth, depth)
        if leaf:
            self._order.append(faces)
        else:
            along = self._centers[faces, (high - low).argmax()]
            faces, half = faces[np.argsort(along, kind="stable")], len(faces) // 2
            self._grow(faces[:half], first, depth + 1)
            self._grow(faces[half:], first + half, depth + 1)
        self._links[node] = (len(self._boxes), first, len(faces) if leaf else 0)

    def search(self, ray: Approach, any_hit: bool) -> Found:
        count = dr.opaque(UInt32, self.nodes)

        def visit(node: UInt32, found: Found) -> tuple[UInt32, Found]:
            words: Any = dr.gather(ArrayXu, self._words, node, shape=(16, 1))
            sides = [dr.reinterpret_array(Float, word) for word in list(words)[:6]]
            entry, leave = ray.through(Vector3f(sides[:3]), Vector3f(sides[3:]))
            hit = maximum(entry, Float(0)) <= minimum(leave, found.t)
            item, size = words[7], words[8]
            _, found = self.table.visit_list(ray, self._faces, item, item + dr.select(hit, size, 0), found, any_hit)
            return dr.select(hit, node + 1, words[6]), found

        def unfinished(node: UInt32, found: Found) -> Bool:
            return (node < count) & ((found.face == NO_FACE) if any_hit else Bool(True))

        start = wide((UInt32(0), ray.nothing_yet()), ray.lanes)
        _, found = while_loop(start, unfinished, visit, label="simple BVH")
        result: Found = found
        return result

    def leaves(self) -> list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint32]]]:
        """The leaves: two corners of the box, relative to the middle of all triangles, and the faces in it."""
        faces = self._faces.numpy()
        return [
            (box[:3], box[3:], faces[first : first + count])
            for box, (_, first, count) in zip(self._boxes, self._links, strict=True)
            if count
        ]

    def statistics(self) -> Statistics:
        """Measure the tree's size and quality."""
        boxes = np.array(self._boxes)
        area = half_area(boxes[:, :3], boxes[:, 3:])
        # A node is met with the probability of its box, a triangle with that of its leaf.
        tests = 1 + np.array([count for _, _, count in self._links])
        cost = float((area * tests).sum() / area[0])
        memory = 4 * (dr.width(self._words) + dr.width(self._faces) + dr.width(self.table.words))
        count = self.table.count
        return Statistics(count, self.nodes, count, self.depth, cost, memory, self.seconds)
