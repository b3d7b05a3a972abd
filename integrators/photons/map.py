"""The photon map: photons in the cells of a grid, and sums over those near a point.

A hash says where the photons of a cell lie. They are counted per hash value, the counts are summed up, and each photon
is put where those of its value belong: nothing is sorted. Cells that follow each other along x have values that follow
each other: they make a row, and any part of a row is one run of photons. So cells are short along x, and a sum asks for
the rows that a disk about its point reaches, each as far as the disk does. Within a cell photons lie in any order,
which threads decide; sums over them are made of whole numbers and don't depend on it.

H. W. Jensen, "Global Illumination using Photon Maps", 1996. Counting in place of sorting is that of T. Davidovič,
J. Křivánek, M. Hašan and P. Slusallek, "Progressive Light Transport Simulation on the GPU", 2014.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.integrators.photons.cells import Box
from djpt.integrators.photons.photon import MOST_EDGES, NOWHERE, WORDS, Photon, PhotonStore, memory_for, unpacked
from djpt.jit.kernels import as_float, power_of_two, while_loop, wide
from djpt.jit.types import (
    Array4f,
    ArrayXf,
    Bool,
    Color3f,
    Float,
    Float64,
    Int32,
    Int64,
    Normal3f,
    Point3f,
    UInt32,
    Vector2f,
    Vector3f,
)

__all__ = ["FACING", "PhotonMap"]

DIGITS = 32
"""Fractional bits of sums, in units of a typical colour: the integer part has as many, less one."""

LENGTH = 1 / 2
"""The length of a cell along x, in relation to the radius."""

WIDTH = 2.0
"""Its width along y and z, in relation to the radius."""

SHIFT = 0.382
"""Position of the origin in its cell along y and z: floors at 0 are common, and shouldn't lie between two cells."""

MOST_ALONG, MOST_ACROSS = 6, 4
"""The cells along x, and along y or z, that a ball may reach into: one more than fit, since numbers are rounded."""

FLATNESS = 0.1
"""The largest distance of photons from the tangent plane over the radius: beyond edges they don't count."""

FACING = 0.5
"""The least cosine of a photon's normal to the surface's: those on walls don't count for the floor below."""

AT_ONCE = 4
"""Photons that a lane reads between two tests for the end of its run."""

FAR = 2**30
"""The number of the last cell along an axis: it also holds everything beyond."""

FEWEST = 2**10
"""Hash values of a map with few photons."""

ALONG_Y, ALONG_Z = 19349663, 83492791
"""Growth of the hash from cell to cell; by 1 along x. No two cells that a ball reaches into have equal hashes."""


class PhotonMap:
    """The photons of a pass, ready for sums over those near a point."""

    in_media = False
    """True if some of its photons are in media."""

    def __init__(self, radius: float, paths: int, unit: float, box: Box | None = None) -> None:
        """Create a map without photons: `fill` adds them.

        Args:
            radius: the distance up to which photons count.
            paths: the light paths that they come from.
            unit: a radiance of typical size, a power of two: it sets the precision of sums.
            box: a box about most photons in media; None if nobody asks for it.
        """
        self.box = box
        self.paths = paths
        density = math.pi * radius**2 * paths
        self.expected = as_float(density)
        """The photons within the radius per density of light paths: pi radius^2 paths."""
        self.expected_in_ball = as_float(4 / 3 * radius * density)
        """The photons within the radius of a point in a medium, per density of light paths: 4/3 pi radius^3 paths."""
        self.radius, self._square = as_float(radius), as_float(radius**2)
        self._per_depth = as_float(3 / 4 / radius)
        self.height = as_float(FLATNESS * radius)
        """The largest distance from the tangent plane at which they count."""
        self._width = as_float(WIDTH * radius)
        self._per_length, self._per_width = as_float(1 / (LENGTH * radius)), as_float(1 / (WIDTH * radius))
        self._scale, self._unit = as_float(2.0**DIGITS / (unit * density)), as_float(unit * 2.0**-DIGITS)

    def fill(self, store: PhotonStore, count: int) -> None:
        """Take over the `count` photons of a store, and put them where those of their hash values belong.

        Photons that have weights stay where they are, and only their numbers are put into order: few of them are
        looked at.
        """
        self.in_media = store.in_media
        values = max(FEWEST, power_of_two(count))
        self._mask, self._count = dr.opaque(UInt32, values - 1), dr.opaque(UInt32, count)
        counts = dr.opaque(UInt32, 0, values)
        if count:
            photon = dr.arange(UInt32, count) + dr.opaque(UInt32, 0)
            place = dr.gather(Array4f, store.photons, photon * (WORDS // 4))
            value = self._hash(self._along(place[0]), self._across(place[1]), self._across(place[2]))
            rank: Any = dr.scatter_inc(counts, value)
            dr.eval(rank, value)
        self._begin = dr.cumsum(counts) - counts
        self._weighted, self._order = store.weighted, None
        self._photons, self._weights = store.photons, store.weights
        if count:
            target = dr.gather(UInt32, self._begin, value) + rank
            if store.weighted:
                self._order = dr.empty(UInt32, count)
                dr.scatter(self._order, photon, target)
                dr.eval(self._order)
            else:
                self._photons, _ = memory_for(count, False)
                dr.scatter(self._photons, dr.gather(ArrayXf, store.photons, photon, shape=(WORDS, count)), target)
        dr.eval(self._begin, self._photons, self._weights)

    def _along(self, x: Float) -> Int32:
        """The number of the cell along x."""
        return cell(x * self._per_length)

    def _across(self, c: Float) -> Int32:
        """The number of the cell along y or z."""
        return cell(dr.fma(c, self._per_width, SHIFT))

    def _hash(self, x: Int32, y: Int32, z: Int32) -> UInt32:
        return (UInt32(x) + UInt32(y) * ALONG_Y + UInt32(z) * ALONG_Z) & self._mask

    def _run(self, p: Point3f, reach: Float, y: Int32, z: Int32, asked: Bool) -> tuple[UInt32, UInt32]:
        """The photons of the row (y, z) near a point: the number of the first one, and one past the last.

        Runs past the last hash value continue at the first one, whose numbers follow those of all photons.
        """
        rest = self._square - dr.square(self._distance(p.y, y)) - dr.square(self._distance(p.z, z))
        asked = asked & (rest > 0)
        reach = dr.minimum(reach, dr.safe_sqrt(rest))
        first, last = self._along(p.x - reach), self._along(p.x + reach)
        begin, end = self._hash(first, y, z), self._hash(dr.minimum(last + 1, first + MOST_ALONG), y, z)
        wraps = asked & (end < begin)
        start, stop = (dr.gather(UInt32, self._begin, value, asked) for value in (begin, end))
        return start, stop + dr.select(wraps, self._count, 0)

    def _distance(self, c: Float, number: Int32) -> Float:
        """The distance of a coordinate y or z from the cells of a number."""
        low = (Float(number) - SHIFT) * self._width
        beside: Float = dr.maximum(low - c, c - low - self._width)
        return dr.select(beside > 0, beside, Float(0))

    def _of_run(self, i: UInt32, there: Bool, lanes: int) -> Photon:
        """A photon of a run."""
        number = dr.select(i < self._count, i, i - self._count)
        return self.photon(
            number if self._order is None else dr.gather(UInt32, self._order, number, there), there, lanes
        )

    def photon(self, i: UInt32, there: Bool, lanes: int) -> Photon:
        """The photon of a number."""
        packet = dr.gather(ArrayXf, self._photons, i, there, shape=(WORDS, lanes))
        weights = dr.gather(Vector2f, self._weights, i, there) if self._weighted else None
        return unpacked(packet, weights, self.in_media)

    def density(
        self, p: Point3f, n: Normal3f, edges: UInt32, active: Bool, worth: Callable[[Photon], Color3f]
    ) -> Color3f:
        """The sum of contributions of photons near a point, over the area of the disk and the number of light paths.

        Args:
            p: the point, on a surface.
            n: the surface's normal.
            edges: the most edges of the photons' paths that count; all paths of more than `MOST_EDGES` of
                `djpt.integrators.photons.photon` count alike.
            active: lanes that have a sum; in others it is 0.
            worth: the contribution of a photon within the radius, a colour.
        """
        # How far the disk reaches, with the photons above and below it.
        reach = [
            dr.minimum(self.radius, self.radius * dr.safe_sqrt(1 - dr.square(c)) + self.height * dr.abs(c)) for c in n
        ]

        def belongs(photon: Photon, to: Vector3f) -> Bool:
            on_surface = (dr.abs(dr.dot(to, n)) <= self.height) & (dr.dot(photon.n, n) >= FACING)
            return on_surface if photon.medium is None else on_surface & (photon.medium == NOWHERE)

        return self._sum(p, reach, edges, active, belongs, worth)

    def density_in_medium(
        self, p: Point3f, medium: UInt32, edges: UInt32, active: Bool, worth: Callable[[Photon], Color3f]
    ) -> Color3f:
        """The sum of contributions of photons near a point, over the volume of the ball and the number of light paths.

        Args:
            p: the point, in a medium.
            medium: the number of that medium: photons in others don't count.
            edges: as for `density`.
            active: as for `density`.
            worth: as for `density`.
        """
        reach = [self.radius] * 3

        def belongs(photon: Photon, to: Vector3f) -> Bool:
            assert photon.medium is not None
            return photon.medium == medium

        return self._per_depth * self._sum(p, reach, edges, active, belongs, worth)

    def _sum(
        self,
        p: Point3f,
        reach: list[Float],
        edges: UInt32,
        active: Bool,
        belongs: Callable[[Photon, Vector3f], Bool],
        worth: Callable[[Photon], Color3f],
    ) -> Color3f:
        """The sum over the photons of a ball, over the area of its disk and the number of light paths.

        `reach` is how far those that count lie from its centre along x, y and z; `belongs` tells by a photon and
        the vector to it whether it counts.
        """
        lanes = dr.width(p, active)
        most = Float(dr.minimum(edges, MOST_EDGES))
        x, y, z = reach
        y0, z0 = self._across(p.y - y), self._across(p.z - z)
        y1 = dr.minimum(self._across(p.y + y), y0 + (MOST_ACROSS - 1))
        z1 = dr.minimum(self._across(p.z + z), z0 + (MOST_ACROSS - 1))

        def add(i: UInt32, there: Bool, total: list[Int64]) -> list[Int64]:
            photon = self._of_run(i, there, lanes)
            to = photon.p - p
            counts = there & belongs(photon, to) & (dr.squared_norm(to) <= self._square) & (photon.edges <= most)
            return self.added(total, counts, worth(photon))

        def step(y: Int32, z: Int32, i: UInt32, end: UInt32, total: list[Int64]) -> tuple[Any, ...]:
            for _ in range(AT_ONCE):
                there = i < end
                total = add(i, there, total)
                i = dr.select(there, i + 1, i)
            # The next row, where this one has no more photons.
            done, last = i >= end, y >= y1
            z = dr.select(done & last, z + 1, z)
            y = dr.select(done, dr.select(last, y0, y + 1), y)
            start, stop = self._run(p, x, y, z, done & (z <= z1))
            return y, z, dr.select(done, start, i), dr.select(done, stop, end), total

        # A lane ends behind the last row.
        z0 = dr.select(active, z0, z1 + 1)
        start, stop = self._run(p, x, y0, z0, active)
        sums = self.zero(lanes)
        state = (wide(y0, lanes), wide(z0, lanes), wide(start, lanes), wide(stop, lanes), sums)
        done = while_loop(state, lambda y, z, i, end, total: z <= z1, step, label="photons")
        return self.color(done[4])

    def position(self, i: UInt32, there: Bool) -> tuple[Point3f, UInt32]:
        """The position of a photon by its number, and what its word says: see `djpt.integrators.photons.photon`."""
        packet = dr.gather(Array4f, self._photons, i * (WORDS // 4), there)
        word: Any = dr.reinterpret_array(UInt32, packet[3])
        return Point3f(packet[0], packet[1], packet[2]), UInt32(word)

    def zero(self, lanes: int) -> list[Int64]:
        """A sum of no contributions."""
        return [dr.zeros(Int64, lanes) for _ in range(3)]

    def added(self, total: list[Int64], counts: Bool, worth: Color3f) -> list[Int64]:
        """A sum with the contribution of one more photon, if it `counts`."""
        color = worth * self._scale
        return [t + Int64(dr.round(dr.select(counts, c, 0))) for t, c in zip(total, color, strict=True)]

    def color(self, total: list[Int64]) -> Color3f:
        """A sum as a colour."""
        return Color3f(*(Float(Float64(t)) * self._unit for t in total))


def cell(c: Float) -> Int32:
    """The number of the cell that a coordinate in widths of cells lies in."""
    return Int32(dr.clip(dr.floor(c), -FAR, FAR))
