"""The guide of paths: a distribution of directions for each leaf of a tree over the scene.

A distribution gives each square of the map of directions a number of tickets, out of `TICKETS`. A list of all tickets
makes drawing one lookup, and another lookup tells the density of any direction.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.warp import direction_at, place_of
from djpt.jit.kernels import as_vector, maximum, minimum, own_copy, own_floats
from djpt.jit.types import Bool, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f

__all__ = ["SIDE", "SIDES", "SQUARES", "Cells", "Guide", "Heading", "Leaves", "LocalGuide"]

SIDES = 6
"""The directions along axes that surfaces are sorted by."""

HALVINGS = 16
"""The number of halvings, each of which doubles the number of cells."""


class Cells:
    """Cells of equal size that fill a box, in six copies.

    The box about the scene is halved again and again, always across its longest edge. The last halves are the cells;
    each exists six times, for surfaces that face along +x, -x, +y, -y, +z and -z. Neighbouring cells in which few paths
    have been are put together to the leaves of a tree. A kernel doesn't descend the tree: a table has the leaf of each
    cell.
    """

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


SIDE = 32
"""The squares along an edge of the map of directions: 6 degrees each."""

SQUARES = SIDE * SIDE

TICKETS = 1024
"""The tickets of a leaf; squares that deserve less than half a ticket get none."""


class Guide:
    """Distributions of directions in which paths leave surfaces, by position and side of the surface."""

    def __init__(self, cells: Cells, leaves: Leaves, weights: NDArray[np.float64], share: NDArray[np.float64]) -> None:
        """Make the tables.

        Args:
            cells: The cells.
            leaves: The leaves that they belong to.
            weights: (leaves, SQUARES): the tickets that each square should have, up to a factor for each leaf; all 0
                where nothing is known.
            share: (leaves,): the chance that a guide is followed; where nothing is known none is.
        """
        self.cells, self.leaves, self.weights, self.share = cells, leaves, weights, share
        total = weights.cumsum(axis=1)
        all_weight = total[:, -1:]
        known = all_weight > 0
        drawn = np.floor(total / np.where(known, all_weight, 1) * TICKETS + 0.5).astype(np.uint16)
        drawn = np.where(known, drawn, TICKETS).astype(np.uint16)
        tickets = np.diff(drawn, axis=1, prepend=np.uint16(0))
        squares = np.repeat(np.tile(np.arange(SQUARES, dtype=np.uint16), leaves.count), tickets.ravel())
        self._leaf_of_cell = own_copy(leaves.of_cell)
        self._share = own_floats((share * known[:, 0]).astype(np.float32))
        self._tickets, self._squares = (own_copy(halves.ravel().view(np.uint32)) for halves in (tickets, squares))

    def at(self, p: Point3f, n: Normal3f, active: Bool | bool = True) -> LocalGuide:
        """The guide at a surface point with the normal `n`; there is nothing to follow on lanes that aren't active."""
        cell = self.cells.at(p, n)
        leaf = dr.gather(UInt32, self._leaf_of_cell, cell, active)
        return LocalGuide(cell, leaf, dr.gather(Float, self._share, leaf, active), self._tickets, self._squares)


@dataclass
class LocalGuide:
    """The guide at the surface point of each lane."""

    cell: UInt32
    leaf: UInt32
    share: Float
    """The chance of following the guide: 0 where nothing is known."""
    tickets: UInt32
    """The tickets of each square, leaf by leaf; two numbers in a word."""
    squares: UInt32
    """The square of each ticket, in the same form."""

    def sample(self, u: Float, within: Point2f, active: Bool | bool = True) -> Vector3f:
        """A direction: `u` draws a ticket, `within` a place on its square."""
        ticket = UInt32(minimum(u * TICKETS, TICKETS - 1.0))
        # Memory is what takes the time of a guide: other lanes don't touch it.
        square = half_word(self.squares, dr.fma(self.leaf, TICKETS, ticket), active)
        corner = Point2f(Float(square & (SIDE - 1)), Float(square // SIDE))
        return direction_at(dr.fma(corner + within, 2 / SIDE, -1))

    def heading(self, d: Vector3f, active: Bool | bool = True) -> Heading:
        """The square and the density of a direction; 0 on lanes that aren't active."""
        place, spread = place_of(d)
        column, row = (UInt32(minimum(dr.fma(c, SIDE / 2, SIDE / 2), SIDE - 1.0)) for c in place)
        square = dr.fma(self.leaf, SQUARES, dr.fma(row, SIDE, column))
        tickets = half_word(self.tickets, square, active)
        # The map has the area 4. What isn't a number is no direction.
        pdf = dr.select(spread > 0, Float(tickets) * (SQUARES / 4 / TICKETS) * dr.rcp(spread), 0)
        return Heading(square, pdf, spread)


@dataclass
class Heading:
    """A direction as a guide sees it."""

    square: UInt32
    """The number of its square, among those of all leaves."""
    pdf: Float
    """The density with which `LocalGuide.sample` gives it, per unit solid angle."""
    spread: Float
    """The solid angle per area of the map there."""


def half_word(memory: UInt32, index: UInt32, active: Bool | bool) -> UInt32:
    """The entry of an array of 16-bit numbers, which is kept as one of words; 0 on lanes that aren't active."""
    word = dr.gather(UInt32, memory, index >> 1, active)
    return (word >> ((index & 1) << 4)) & 0xFFFF
