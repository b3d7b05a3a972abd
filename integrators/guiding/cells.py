"""The places that a guide tells apart: leaves of a tree over the scene, looked up in a table.

The box about the scene is halved again and again, always across its longest edge. The last halves are the cells; each
exists six times, for surfaces that face along +x, -x, +y, -y, +z and -z. Neighbouring cells in which few paths have
been are put together to the leaves of a tree. A kernel doesn't descend the tree: a table has the leaf of each cell.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.jit.kernels import as_vector, maximum, minimum
from djpt.jit.types import Normal3f, Point3f, UInt32

__all__ = ["SIDES", "Cells", "Leaves"]

SIDES = 6
"""The directions along axes that surfaces are sorted by."""

HALVINGS = 16
"""The number of halvings, each of which doubles the number of cells."""


class Cells:
    """Cells of equal size that fill a box, in six copies."""

    def __init__(self, low: Any, high: Any) -> None:
        """`low` and `high`: the corners of the box, three numbers each; a point if there is none."""
        low, high = np.array(low, float).ravel(), np.array(high, float).ravel()
        if (low > high).any():
            low, high = np.zeros(3), np.zeros(3)
        edges = np.maximum(high - low, 1e-6 * max(float((high - low).max()), 1e-30))
        self.axes: list[int] = []
        """The axis of each halving, the first one first."""
        left = edges.copy()
        for _ in range(HALVINGS):
            axis = int(np.argmax(left))
            left[axis] /= 2
            self.axes.append(axis)
        self._bits = [self.axes.count(axis) for axis in range(3)]
        counts = [2**bits for bits in self._bits]
        self.count = SIDES * 2**HALVINGS
        self._low, self._scale = as_vector(low), as_vector(np.array(counts) / edges)
        self._last = as_vector(np.array(counts, float) - 1)
        self._shift_y, self._shift_z = (dr.opaque(UInt32, sum(self._bits[:axis])) for axis in (1, 2))

    def at(self, p: Point3f, n: Normal3f) -> UInt32:
        """The number of the cell of a point on a surface with the normal `n`; of the nearest cell from outside."""
        place = (p - self._low) * self._scale
        x, y, z = (UInt32(minimum(maximum(c, 0.0), last)) for c, last in zip(place, self._last, strict=True))
        a = dr.abs(n)
        along_x = (a.x >= a.y) & (a.x >= a.z)
        axis = dr.select(along_x, UInt32(0), dr.select(a.y >= a.z, UInt32(1), 2))
        along = dr.select(along_x, n.x, dr.select(a.y >= a.z, n.y, n.z))
        side = 2 * axis + dr.select(along < 0, UInt32(1), 0)
        return (side << HALVINGS) + x + (y << self._shift_y) + (z << self._shift_z)

    @functools.cached_property
    def order(self) -> NDArray[np.intp]:
        """The numbers of all cells in the order of the tree's leaves: the two halves of each box follow each other."""
        rank = np.arange(2**HALVINGS)
        place = np.zeros((3, len(rank)), np.int64)
        for halving, axis in enumerate(self.axes):
            place[axis] = 2 * place[axis] + (rank >> (HALVINGS - 1 - halving) & 1)
        number = place[0] + (place[1] << self._bits[0]) + (place[2] << self._bits[0] + self._bits[1])
        return (np.arange(SIDES)[:, None] * 2**HALVINGS + number).ravel()


@dataclass
class Leaves:
    """The leaves of a tree over the cells."""

    of_cell: NDArray[np.uint32]
    """The number of the leaf of each cell."""
    count: int

    @staticmethod
    def equal(cells: Cells, halvings: int) -> Leaves:
        """The leaves after so many halvings."""
        of_cell = np.empty(cells.count, np.uint32)
        of_cell[cells.order] = np.repeat(np.arange(SIDES * 2**halvings), 2 ** (HALVINGS - halvings))
        return Leaves(of_cell, SIDES * 2**halvings)

    @staticmethod
    def by_visits(cells: Cells, visits: NDArray[np.uint32], most: float) -> Leaves:
        """The largest boxes with fewer than `most` visits, `visits` being the number of those in each cell."""
        order = cells.order
        sorted_visits = visits[order].astype(np.int64)
        label = np.full(SIDES, -1, np.int64)
        count = 0
        for halvings in range(HALVINGS + 1):
            inside = sorted_visits.reshape(len(label), -1).sum(axis=1)
            ends = (label < 0) & ((inside < most) | (halvings == HALVINGS))
            label[ends] = count + np.arange(int(ends.sum()))
            count += int(ends.sum())
            if halvings < HALVINGS:
                label = np.repeat(label, 2)
        of_cell = np.empty(cells.count, np.uint32)
        of_cell[order] = label
        return Leaves(of_cell, count)
