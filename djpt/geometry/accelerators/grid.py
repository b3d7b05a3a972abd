"""A uniform grid: cells of equal size, each with a list of the triangles in it.

A ray walks from cell to cell: J. Amanatides and A. Woo, "A Fast Voxel Traversal Algorithm for Ray
Tracing", 1987.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.geometry.accelerators.base import NO_FACE, Approach, Found, SearchedTable, Statistics, TriangleTable
from djpt.jit.kernels import as_vector, shared, while_loop, wide
from djpt.jit.types import Bool, Float, UInt32

__all__ = ["UniformGrid"]

MAX_CELLS = 512
"""Most cells along one axis."""

MAX_REFERENCES = 16
"""Most references per triangle, on average: large triangles in a fine grid would fill the memory."""


@dataclass
class Walk:
    """A ray in a cell: loop state."""

    cell: list[UInt32]
    """The cell's place along x, y, z."""
    item: UInt32
    end: UInt32
    """The end of the cell's list; entries from `item` to `end` are still to be tested."""
    leave: Float
    """The distance at which the ray leaves the cell."""
    found: Found
    active: Bool


class UniformGrid(SearchedTable):
    """A grid of about `density` cells per triangle (J. Cleary and G. Wyvill, 1988, and others advise a few)."""

    def __init__(self, corners: NDArray[np.float32], density: float = 4.0) -> None:
        start = time.perf_counter()
        self.table = TriangleTable(corners)
        low, high = self.table.low.min(axis=0), self.table.high.max(axis=0)
        while True:
            self.cells = resolution(high - low, density * len(corners))
            first, last = (self._cells_at(x, low, high) for x in (self.table.low, self.table.high))
            extent = last - first + 1
            if extent.prod(axis=1).sum() <= MAX_REFERENCES * len(corners) or self.cells.max() == 1:
                break
            density /= 2
        faces, cells = pairs(first, extent, self.cells)
        order = np.argsort(cells, kind="stable")
        counts = np.bincount(cells, minlength=int(self.cells.prod()))
        self.counts = counts
        self.references = len(faces)
        self._first = shared(np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32))
        self._faces = shared(faces[order].astype(np.uint32))
        self._n = [dr.opaque(UInt32, int(n)) for n in self.cells]
        self._low, self._high, self._size = (as_vector(v) for v in (low, high, (high - low) / self.cells))
        self.seconds = time.perf_counter() - start

    def _cells_at(
        self, points: NDArray[np.float32], low: NDArray[np.float32], high: NDArray[np.float32]
    ) -> NDArray[np.int64]:
        return np.clip(((points - low) / (high - low) * self.cells).astype(np.int64), 0, self.cells - 1)

    # ---- the walk --------------------------------------------------------------------

    def search(self, ray: Approach, any_hit: bool) -> Found:
        entry, leave = ray.through(self._low, self._high)
        begin = (ray.o + ray.d * entry - self._low) / self._size
        cell = [dr.clip(UInt32(dr.maximum(begin[a], 0)), 0, self._n[a] - 1) for a in range(3)]
        zero = UInt32(0)
        walk = wide(Walk(cell, zero, zero, Float(0), ray.nothing_yet(), entry <= leave), ray.lanes)
        (walk,) = while_loop(
            (self._arrive(ray, walk),),
            lambda walk: walk.active,
            lambda walk: (self._step(ray, walk, any_hit),),
            label="grid",
        )
        found: Found = walk.found
        return found

    def _arrive(self, ray: Approach, walk: Walk) -> Walk:
        """Begin the list of the cell that the walk has come to."""
        x, y, z = walk.cell
        index = (z * self._n[1] + y) * self._n[0] + x
        item = dr.gather(UInt32, self._first, index, walk.active)
        end = dr.gather(UInt32, self._first, index + 1, walk.active)
        planes = self._exits(ray, walk.cell)
        leave = dr.minimum(dr.minimum(planes[0], planes[1]), planes[2])
        return Walk(walk.cell, item, end, leave, walk.found, walk.active)

    def _exits(self, ray: Approach, cell: list[UInt32]) -> list[Float]:
        """The distances to the far planes of a cell, computed anew for each cell, so that no errors add up."""
        result = []
        for a in range(3):
            plane: Any = dr.fma(Float(cell[a] + dr.select(ray.inv[a] > 0, UInt32(1), 0)), self._size[a], self._low[a])
            result.append((plane - ray.o[a]) * ray.inv[a])
        return result

    def _step(self, ray: Approach, walk: Walk, any_hit: bool) -> Walk:
        """Test the cell's triangles, then go on."""
        item, found = self.table.visit_list(ray, self._faces, walk.item, walk.end, walk.found, any_hit)
        planes = self._exits(ray, walk.cell)
        # A hit further away than this cell may lie behind one in the next.
        active = walk.active & (found.t > walk.leave)
        if any_hit:
            active &= found.face == NO_FACE
        pending = Bool(True)
        cell = []
        for a in range(3):
            steps = pending & (planes[a] == walk.leave)
            pending &= ~steps
            # Below zero wraps around, so one comparison finds both ends.
            moved = walk.cell[a] + dr.select(ray.inv[a] > 0, UInt32(1), UInt32(0xFFFFFFFF))
            cell.append(dr.select(steps, moved, walk.cell[a]))
            active &= cell[a] < self._n[a]
        return self._arrive(ray, Walk(cell, item, walk.end, walk.leave, found, active))

    # ---- size ------------------------------------------------------------------------

    def statistics(self) -> Statistics:
        """Measure the grid; a line through its box meets a cell with the probability area(cell) / area(box)."""
        size = np.asarray(self._size.numpy()).ravel()
        faces = np.array([size[1] * size[2], size[2] * size[0], size[0] * size[1]])
        ratio = float(faces.sum() / (faces * (self.cells.prod() / self.cells)).sum())
        cost = ratio * (self.counts.sum() + len(self.counts))
        memory = 4 * (dr.width(self._first) + dr.width(self._faces) + dr.width(self.table.words))
        return Statistics(self.table.count, len(self.counts), self.references, 1, cost, memory, self.seconds)


def resolution(extent: NDArray[np.float32], cells: float) -> NDArray[np.int64]:
    """The numbers of cells along the axes for about `cells` cubes in all."""
    size = np.maximum(extent.astype(np.float64), 1e-3 * float(extent.max()))
    side = float((size.prod() / cells) ** (1 / 3))
    return np.clip(np.round(size / side).astype(np.int64), 1, MAX_CELLS)


def pairs(
    first: NDArray[np.int64], extent: NDArray[np.int64], cells: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All pairs of a triangle and a cell that its box touches."""
    count = extent.prod(axis=1)
    face = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    nx, ny = extent[face, 0], extent[face, 1]
    x, y, z = within % nx, within // nx % ny, within // (nx * ny)
    x, y, z = (part + first[face, a] for a, part in enumerate((x, y, z)))
    return face, (z * cells[1] + y) * cells[0] + x
