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
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.core.records.flags import SurfaceDetail
from djpt.core.warp import square_to_uniform_disk_concentric
from djpt.integrators.photons.photon import MOST_EDGES, WORDS, Photon, PhotonStore, memory_for, unpacked
from djpt.jit.kernels import as_float, while_loop, wide
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
from djpt.samplers.base import SampleStream, go_on_with

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["PhotonMap", "inverse_coverage"]

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

    def __init__(self, radius: float, paths: int, unit: float) -> None:
        """Create a map without photons: `fill` adds them.

        Args:
            radius: the distance up to which photons count.
            paths: the light paths that they come from.
            unit: a radiance of typical size, a power of two: it sets the precision of sums.
        """
        density = math.pi * radius**2 * paths
        self.expected = as_float(density)
        """The photons within the radius per density of light paths: pi radius^2 paths."""
        self.radius, self._square = as_float(radius), as_float(radius**2)
        self.height = as_float(FLATNESS * radius)
        """The largest distance from the tangent plane at which they count."""
        self._width = as_float(WIDTH * radius)
        self._per_length, self._per_width = as_float(1 / (LENGTH * radius)), as_float(1 / (WIDTH * radius))
        self._scale, self._unit = as_float(2.0**DIGITS / (unit * density)), as_float(unit * 2.0**-DIGITS)

    def fill(self, store: PhotonStore, count: int) -> None:
        """Take over the `count` photons of a store, and put them where those of their hash values belong."""
        values = max(FEWEST, 1 << (count - 1).bit_length())
        self._mask, self._count = dr.opaque(UInt32, values - 1), dr.opaque(UInt32, count)
        counts = dr.opaque(UInt32, 0, values)
        if count:
            photon = dr.arange(UInt32, count) + dr.opaque(UInt32, 0)
            place = dr.gather(Array4f, store.photons, photon * (WORDS // 4))
            value = self._hash(self._along(place[0]), self._across(place[1]), self._across(place[2]))
            rank: Any = dr.scatter_inc(counts, value)
            dr.eval(rank, value)
        self._begin = dr.cumsum(counts) - counts
        self._photons, self._weights = memory_for(max(1, count), store.weighted)
        self._weighted = store.weighted
        if count:
            target = dr.gather(UInt32, self._begin, value) + rank
            dr.scatter(self._photons, dr.gather(ArrayXf, store.photons, photon, shape=(WORDS, count)), target)
            if store.weighted:
                dr.scatter(self._weights, dr.gather(Vector2f, store.weights, photon), target)
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

    def _photon(self, i: UInt32, there: Bool, lanes: int) -> Photon:
        """A photon of a run."""
        i = dr.select(i < self._count, i, i - self._count)
        packet = dr.gather(ArrayXf, self._photons, i, there, shape=(WORDS, lanes))
        return unpacked(packet, dr.gather(Vector2f, self._weights, i, there) if self._weighted else None)

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
        lanes = dr.width(p, active)
        most = Float(dr.minimum(edges, MOST_EDGES))
        # How far the disk reaches, with the photons above and below it.
        x, y, z = (
            dr.minimum(self.radius, self.radius * dr.safe_sqrt(1 - dr.square(c)) + self.height * dr.abs(c)) for c in n
        )
        y0, z0 = self._across(p.y - y), self._across(p.z - z)
        y1 = dr.minimum(self._across(p.y + y), y0 + (MOST_ACROSS - 1))
        z1 = dr.minimum(self._across(p.z + z), z0 + (MOST_ACROSS - 1))

        def add(i: UInt32, there: Bool, total: list[Int64]) -> list[Int64]:
            photon = self._photon(i, there, lanes)
            to = photon.p - p
            on_surface = (dr.abs(dr.dot(to, n)) <= self.height) & (dr.dot(photon.n, n) >= FACING)
            counts = there & on_surface & (dr.squared_norm(to) <= self._square) & (photon.edges <= most)
            color = worth(photon) * self._scale
            return [t + Int64(dr.round(dr.select(counts, c, 0))) for t, c in zip(total, color, strict=True)]

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
        sums = [dr.zeros(Int64, lanes) for _ in range(3)]
        state = (wide(y0, lanes), wide(z0, lanes), wide(start, lanes), wide(stop, lanes), sums)
        done = while_loop(state, lambda y, z, i, end, total: z <= z1, step, label="photons")
        return Color3f(*(Float(Float64(t)) * self._unit for t in done[4]))


def cell(c: Float) -> Int32:
    """The number of the cell that a coordinate in widths of cells lies in."""
    return Int32(dr.clip(dr.floor(c), -FAR, FAR))


MOST = 16
"""Points of a disk, at most. In the corner of a room, where c = 1/4, one in a hundred such sequences ends too early."""

PRECISION = 2.0**-17
"""The minimum height of ray origins over 1 + the largest coordinate: below it, rounding errors decide what they hit."""


@dataclass
class Search:
    """Loop state."""

    sampler: Any
    points: UInt32
    arrived: Bool
    active: Bool


def inverse_coverage(
    scene: Scene, photons: PhotonMap, si: SurfaceInteraction3f, sampler: SampleStream, active: Bool
) -> Float:
    """An estimate of 1 / c, c being the fraction of the disk about a point where photons count; 1 where not `active`.

    A sum over the photons of a disk is divided by its area. Where a surface ends within the disk, at an edge or at the
    foot of a wall, photons can only lie on the fraction c of it, and the sum is too small by as much: all edges are
    dark by a radius. So points of the disk are looked at until one is on the surface. Their number K is 1 nearly
    everywhere, and has the mean 1 / c everywhere: sums times K have no such error, since K doesn't depend on the
    photons.

    T. E. Booth, "Unbiased Monte Carlo Estimation of the Reciprocal of an Integral", 2007; H. Qin, X. Sun, Q. Hou,
    B. Guo and K. Zhou, "Unbiased Photon Gathering for Light Transport Simulation", 2015, use it for other paths.

    A point of the disk counts if it is seen from the centre along the surface, and the surface there lies near the
    tangent plane and faces the same way. If none is found, because the surface there is smaller than the disk, the
    estimate is 1.
    """
    lanes = dr.width(si.p, active, sampler)
    frame = Frame3f(si.n)
    height, radius = photons.height, photons.radius
    up = si.n * dr.sign(dr.dot(si.n, si.to_world(si.wi)))
    o = dr.fma(up, height, si.p)
    active = active & (height > PRECISION * (1 + dr.max(dr.abs(si.p))))

    def search(search: Search) -> tuple[Search]:
        at = square_to_uniform_disk_concentric(search.sampler.next_2d()) * radius
        # Along the surface, then down to as far below the plane as above it.
        aside = frame.to_world(Vector3f(at.x, at.y, 0))
        length = dr.norm(aside)
        way, down = Ray3f(o, aside * dr.rcp(length), maxt=length), Ray3f(o + aside, -up, maxt=2 * height)
        if "time" in si.__dict__:
            way.time = down.time = si.time
        free = (length > 0) & ~scene.geometry.any_hit(way, search.active)
        there = scene.surface_interaction(down, scene.closest_hit(down), SurfaceDetail.FRAME)
        arrives = free & there.is_valid() & (dr.dot(there.n, si.n) >= FACING)
        points = search.points + 1
        return (Search(search.sampler, points, arrives, search.active & ~arrives & (points < MOST)),)

    start = Search(sampler, dr.zeros(UInt32, lanes), dr.full(Bool, False, lanes), wide(active, lanes))
    (done,) = while_loop((start,), lambda search: search.active, search, label="coverage")
    go_on_with(sampler, done.sampler)
    return dr.select(done.arrived, Float(done.points), 1)
