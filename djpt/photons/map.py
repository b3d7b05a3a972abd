"""The photon map: photons in the cells of a grid, and sums over those near a point.

A hash says where the photons of a cell lie. They are counted per hash value, the counts are summed up, and each photon
is put where those of its value belong: nothing is sorted. Cells that follow each other along x have values that follow
each other, so what lies near a point is found in a few runs of photons. Within a cell photons lie in any order, which
threads decide; sums over them are made of whole numbers and don't depend on it.

H. W. Jensen, "Global Illumination using Photon Maps", 1996. Counting in place of sorting is that of T. Davidovič,
J. Křivánek, M. Hašan and P. Slusallek, "Progressive Light Transport Simulation on the GPU", 2014.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.kernels import as_float, if_stmt, while_loop
from djpt.photons.photon import Photon, PhotonStore, unpacked
from djpt.types import Array4f, Bool, Color3f, Float, Float64, Int32, Int64, Normal3f, Point3f, UInt32

__all__ = ["PhotonMap"]

DIGITS = 32
"""Binary digits behind the point of sums, in units of a usual colour: as many are left before it, less one."""

SPAN = 2
"""The cells along each axis that a ball about a point may reach into: they are as wide as its diameter / (SPAN - 1)."""

ROWS = SPAN * SPAN
"""Rows of such cells along x."""

FLATNESS = 0.1
"""How far from the tangent plane photons count, in relation to the radius: those on other sides of an edge don't."""

LOOKS = 4
"""Photons whose distance a lane asks for before lanes that have found a near one go on with it together."""

FEWEST = 2**10
"""Hash values of a map with few photons."""

ALONG_Y, ALONG_Z = 19349663, 83492791
"""What the hash grows by from cell to cell; by 1 along x. No two cells that a ball reaches into have equal hashes."""


class PhotonMap:
    """The photons of a pass, ready for sums over those near a point."""

    def __init__(self, radius: float, paths: int, unit: float) -> None:
        """A map without photons: `fill` brings them.

        Args:
            radius: the distance up to which photons count.
            paths: the light paths that they come from.
            unit: a radiance of usual size, a power of two: it decides on the digits of sums.
        """
        density = math.pi * radius**2 * paths
        self.expected = as_float(density)
        """The photons within the radius per density of light paths: pi radius^2 paths."""
        self._inverse_size, self._square = as_float((SPAN - 1) / (2 * radius)), as_float(radius**2)
        self._height = as_float(FLATNESS * radius)
        self._scale, self._unit = as_float(2.0**DIGITS / (unit * density)), as_float(unit * 2.0**-DIGITS)

    def fill(self, store: PhotonStore, count: int) -> None:
        """Take over the `count` photons of a store, and put them where those of their hash values belong."""
        values = max(FEWEST, 1 << (count - 1).bit_length())
        self._mask = dr.opaque(UInt32, values - 1)
        counts = dr.opaque(UInt32, 0, values)
        if count:
            photon = dr.arange(UInt32, count) + dr.opaque(UInt32, 0)
            place = dr.gather(Array4f, store.packets[0], photon)
            x, y, z = self._cell(Point3f(place[0], place[1], place[2]) * self._inverse_size)
            value = self._hash(x, y, z)
            rank: Any = dr.scatter_inc(counts, value)
            dr.eval(rank, value)
        first = dr.cumsum(counts) - counts
        dr.eval(first)
        # The photons of the first values stand behind the last ones once more: no run has to start again.
        copies = int(first[SPAN - 1])
        index, total = dr.arange(UInt32, values + SPAN), dr.opaque(UInt32, count)
        self._begin = dr.gather(UInt32, first, index & self._mask) + dr.select(index > self._mask, total, 0)
        dr.eval(self._begin)
        self._packets = [dr.opaque(Float, 0, 4 * max(1, count + copies)) for _ in store.packets]
        if count:
            target = dr.gather(UInt32, first, value) + rank
            for memory, source in zip(self._packets, store.packets, strict=True):
                packet = dr.gather(Array4f, source, photon)
                dr.scatter(memory, packet, target)
                dr.scatter(memory, packet, target + total, value < SPAN - 1)
            dr.eval(self._packets)

    def _cell(self, q: Point3f) -> tuple[Int32, Int32, Int32]:
        """The cell of a point, whose coordinates are in widths of cells."""
        return Int32(dr.floor(q.x)), Int32(dr.floor(q.y)), Int32(dr.floor(q.z))

    def _hash(self, x: Int32, y: Int32, z: Int32) -> UInt32:
        return (UInt32(x) + UInt32(y) * ALONG_Y + UInt32(z) * ALONG_Z) & self._mask

    def density(
        self, p: Point3f, n: Normal3f, edges: UInt32, active: Bool, worth: Callable[[Photon], Color3f]
    ) -> Color3f:
        """The sum of what photons near a point are worth, over the area of a disk of the radius and the light paths.

        Args:
            p: the point, on a surface.
            n: the surface's normal.
            edges: the most edges of the photons' paths that count.
            active: where there is a sum at all; else it is 0.
            worth: what a photon within the radius counts, a colour.
        """
        lanes = dr.width(p, active)
        most = Float(edges)
        x, y, z = self._cell(p * self._inverse_size - (SPAN - 1) / 2)

        def near(i: UInt32, there: Bool) -> Bool:
            """Whether a photon counts."""
            place = dr.gather(Array4f, self._packets[0], i, there)
            to = Point3f(place[0], place[1], place[2]) - p
            on_surface = dr.abs(dr.dot(to, n)) <= self._height
            return there & on_surface & (dr.squared_norm(to) <= self._square) & (place[3] <= most)

        def step(row: UInt32, i: UInt32, end: UInt32, total: list[Int64]) -> tuple[Any, ...]:
            found = Bool(False)
            for _ in range(LOOKS):
                there = ~found & (i < end)
                found |= near(i, there)
                i = dr.select(there & ~found, i + 1, i)

            def add(i: UInt32, total: list[Int64]) -> tuple[list[Int64]]:
                photon = unpacked(*(dr.gather(Array4f, packet, i, found) for packet in self._packets))
                color = worth(photon) * self._scale
                return ([t + Int64(dr.round(c)) for t, c in zip(total, color, strict=True)],)

            (total,) = if_stmt((i, total), found, add, lambda i, total: (total,), label="photon")
            i = dr.select(found, i + 1, i)
            # The next row, where this one has no more photons.
            done = i >= end
            more = done & (row < ROWS)
            column = row // SPAN
            value = self._hash(x, y + Int32(column), z + Int32(row - column * SPAN))
            i = dr.select(done, dr.gather(UInt32, self._begin, value, more), i)
            end = dr.select(done, dr.gather(UInt32, self._begin, value + SPAN, more), end)
            return dr.select(done, row + 1, row), i, end, total

        # A lane begins before the first row, and ends with the last one.
        none = dr.zeros(UInt32, lanes)
        state = (
            dr.select(active, none, ROWS + 1),
            none,
            dr.zeros(UInt32, lanes),
            [dr.zeros(Int64, lanes) for _ in range(3)],
        )
        done = while_loop(state, lambda row, i, end, total: row <= ROWS, step, label="photons")
        return Color3f(*(Float(Float64(t)) * self._unit for t in done[3]))
