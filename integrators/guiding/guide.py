"""The guide of paths: a distribution of directions for each leaf of a tree over the scene.

A distribution gives each square of the map of directions a number of tickets, out of `TICKETS`. A list of all tickets
makes drawing one lookup, and another lookup tells the density of any direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.warp import direction_at, place_of
from djpt.integrators.guiding.cells import Cells, Leaves
from djpt.jit.kernels import minimum, own_copy, own_floats
from djpt.jit.types import Bool, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f

__all__ = ["SIDE", "SQUARES", "Guide", "Heading", "LocalGuide"]

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
