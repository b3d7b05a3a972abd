"""Ray queries against a BVH."""

from __future__ import annotations

import time

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import Ray3f
from djpt.geometry.accelerators.base import Statistics
from djpt.geometry.bvh.build.binary import Method, build
from djpt.geometry.bvh.build.wide import collapse, sah_cost
from djpt.geometry.bvh.leaves import TriangleLeaves
from djpt.geometry.bvh.steps.records import LEAF, Records, pack
from djpt.geometry.bvh.steps.trees import search
from djpt.geometry.query import NONE
from djpt.jit.types import Bool, Float, UInt32

__all__ = ["Bvh"]


class Bvh:
    """A bounding volume hierarchy over triangles."""

    def __init__(self, corners: NDArray[np.float32], method: Method = "sah") -> None:
        """`corners` (F, 3, 3) float32."""
        start = time.perf_counter()
        low, high = corners.min(axis=1), corners.max(axis=1)
        tree = collapse(build(low, high, method))
        count = len(corners)
        unused = np.zeros((count, 3), np.float32)
        data = TriangleLeaves(corners, np.full(count, LEAF, np.uint32), unused, unused[:, :2])
        self.records: Records = pack([tree], [data])
        self._seconds = time.perf_counter() - start
        self._faces, self._nodes, self._cost = count, len(tree.child), sah_cost(tree)

    def closest(self, ray: Ray3f) -> tuple[Float, UInt32]:
        """Distance and face of the first hit with 0 < t < maxt; infinity and 0 on a miss."""
        found = search(self.records, ray, False)
        face = face_of(self.records, found.record)
        return dr.select(found.record != NONE, found.t, dr.inf), face

    def any_hit(self, ray: Ray3f) -> Bool:
        """Whether there is a hit with 0 < t < maxt."""
        return search(self.records, ray, True).record != NONE

    def statistics(self) -> Statistics:
        """Measure the tree's size and quality."""
        memory = 4 * dr.width(self.records.words)
        return Statistics(self._faces, self._nodes, self._faces, self.records.depth, self._cost, memory, self._seconds)


def face_of(records: Records, record: UInt32) -> UInt32:
    """The face in a triangle's record; 0 for NONE."""
    return dr.gather(UInt32, records.words, record * 16 + 13, record != NONE)
