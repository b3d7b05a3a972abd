"""The primitives of a BVH under construction: every node owns a range of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.build.splits import MIDDLE, WORDS, Nodes, center, load, no_split
from djpt.jit.kernels import aligned, float_in, shared
from djpt.jit.types import ArrayXu, UInt32

__all__ = ["Level", "Ranges"]

LARGE = 64
"""A primitive is large if its surface is more than so many times the average."""

NONE = 0xFFFFFFFF


@dataclass
class Level:
    """The inner nodes of a level: their ranges lie side by side and fill the records."""

    id: NDArray[np.int32]
    start: NDArray[np.uint32]
    size: NDArray[np.uint32]
    large: NDArray[np.uint32]
    """The number of exceptionally large primitives of each node, which come first in its range."""

    def nodes(self, which: NDArray[np.bool_]) -> tuple[UInt32, Nodes]:
        """The nodes selected by `which`, for kernels: their indices in the level, and their ranges."""
        index = np.flatnonzero(which).astype(np.uint32)
        if len(index) == 1:
            # A kernel for a single lane is another one, and would have to be compiled.
            index = np.repeat(index, 2)
        fields = (shared(field[index]) for field in (self.start, self.size, self.large))
        return shared(index), Nodes(*fields)


@dataclass
class Ranges:
    """The primitives of the nodes that are still to be split."""

    records: UInt32
    segment: UInt32
    """The node of each primitive, by its index in the level."""
    leaf: UInt32
    """The primitive of each finished leaf by node of the tree; NONE for other nodes."""

    @staticmethod
    def of(low: NDArray[np.float32], high: NDArray[np.float32]) -> tuple[Ranges, Level]:
        """Put all primitives into one node, the large ones first."""
        count = len(low)
        with np.errstate(over="ignore", invalid="ignore"):
            x, y, z = (high[:, a] - low[:, a] for a in range(3))
            area = x * y + y * z + z * x
            is_large = area > LARGE * area.mean(dtype=np.float64)
        order = np.concatenate([np.flatnonzero(is_large), np.flatnonzero(~is_large)])
        rows = aligned((count, WORDS))
        rows[:, :3] = low[order].view(np.uint32)
        rows[:, 3:6] = (-high[order]).view(np.uint32)
        rows[:, 6] = order
        records = UInt32(rows.ravel())
        segment = dr.opaque(UInt32, 0, count)
        leaf = dr.opaque(UInt32, NONE, 2 * count - 1)
        one = np.ones(1, np.uint32)
        level = Level(np.zeros(1, np.int32), 0 * one, count * one, is_large.sum(dtype=np.uint32) * one)
        return Ranges(records, segment, leaf), level

    def part(self, level: Level, splits: UInt32, next_id: int) -> Level:
        """Move the primitives of all nodes to their children; return the children that have more than one."""
        before = self.count_left(splits)
        end = level.start + level.size
        total = dr.gather(UInt32, before, shared(end - 1)).numpy()
        start = np.concatenate([np.zeros(1, np.uint32), total[:-1]])
        left = total - start
        empty = (left == 0) | (left == level.size)
        if empty.any():
            # All centroids are equal, or no float lies between them.
            index, nodes = level.nodes(empty)
            dr.scatter(splits, no_split().words(nodes), index)
            return self.part(level, splits, next_id)
        large = np.zeros_like(left)
        if level.large.any():
            last = np.maximum(level.start + level.large, 1) - 1
            large = np.where(level.large > 0, dr.gather(UInt32, before, shared(last)).numpy() - start, 0)
        sizes = np.stack([left, level.size - left], axis=1).ravel()
        larges = np.stack([large, level.large - large], axis=1).ravel().astype(np.uint32)
        inner = sizes > 1
        sizes_inner = np.where(inner, sizes, 0)
        starts = np.cumsum(sizes_inner, dtype=np.uint32) - sizes_inner
        # Added to a primitive's rank among those that go to the same side, this gives its new place.
        offset = starts - np.stack([start, level.start - start], axis=1).ravel()
        segment = np.where(inner, np.cumsum(inner, dtype=np.uint32) - np.uint32(1), np.uint32(NONE))
        self.move(splits, before, shared(offset), shared(segment), int(sizes_inner.sum()), next_id)
        ids = next_id + np.flatnonzero(inner).astype(np.int32)
        return Level(ids, starts[inner], sizes[inner], larges[inner])

    def count_left(self, splits: UInt32) -> UInt32:
        """For each primitive, how many up to and including itself go left."""
        lane = dr.arange(UInt32, dr.width(self.segment))
        box = load(self.records, lane)
        words: Any = dr.gather(ArrayXu, splits, self.segment, shape=(4, 1))
        axis, limit = words[0], words[3]
        c = dr.select(axis == 0, center(box, 0), dr.select(axis == 1, center(box, 1), center(box, 2)))
        goes_left = (c - float_in(words[1])) * float_in(words[2]) < float_in(limit)
        goes_left = dr.select(axis == MIDDLE, lane < limit, goes_left)
        return dr.cumsum(dr.select(goes_left, UInt32(1), UInt32(0)))

    def move(
        self, splits: UInt32, before: UInt32, offset: UInt32, segment: UInt32, remaining: int, next_id: int
    ) -> None:
        """Write all primitives to their new places, or to finished leaves."""
        lane = dr.arange(UInt32, dr.width(before))
        upto = before
        previous = dr.gather(UInt32, before, lane - 1, lane > 0)
        goes_right = upto == previous
        child = 2 * self.segment + dr.select(goes_right, UInt32(1), UInt32(0))
        among = dr.select(goes_right, lane - previous, previous)
        to = dr.gather(UInt32, segment, child)
        target = dr.gather(UInt32, offset, child) + among
        words: Any = dr.gather(ArrayXu, self.records, lane, shape=(WORDS, 1))
        remains = to != NONE
        records, segments = dr.empty(UInt32, max(remaining, 1) * WORDS), dr.empty(UInt32, max(remaining, 1))
        dr.scatter(records, words, target, remains)
        dr.scatter(segments, to, target, remains)
        dr.scatter(self.leaf, words[6], child + dr.opaque(UInt32, next_id), ~remains)
        dr.eval(records, segments, self.leaf)
        self.records, self.segment = records, segments
