"""A grid over a box of space, whose cells know the balls and capsules that reach into them, and rays through it.

Photons count for a ray if it passes them within a radius: if it meets the ball about a photon or, where photons leave
beams, the capsule about a beam. Each of these is noted in all cells that it reaches into, and a ray looks at the cells
it passes through, one after the other. The point of the ray that is nearest to a photon lies in one of them only, and
the photon counts there: nothing counts twice, and no cell beside the ray need be looked at.

Entries are counted per cell, the counts are summed up, and each entry is put where those of its cell belong. Cells may
be much wider than the radius, so a box that is large and sparsely filled takes no more steps than a small one.

J. Amanatides and A. Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", 1987, walk from cell to cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import Ray3f
from djpt.jit.kernels import while_loop, wide
from djpt.jit.types import Bool, Float, Int32, Point3f, UInt32, Vector3f

__all__ = ["Box", "Cells", "Segment"]

MOST_CELLS = 2**22
"""The most cells of a grid."""

ROUNDS = 24
"""Rounds of a fixed-point iteration, each of which divides its error by three."""

SLACK = 1.001
"""Balls and capsules are noted as if they were wider by this factor: rounding must not leave out a cell."""

STILL = 1e-12
"""The slope of a segment that doesn't move along an axis: where it is, it is always."""


@dataclass
class Box:
    """A box of space, with opaque corners."""

    low: Point3f
    high: Point3f

    @staticmethod
    def of(low: NDArray[np.floating[Any]], high: NDArray[np.floating[Any]]) -> Box:
        """The box with two corners."""
        return Box(*(Point3f(*(dr.opaque(Float, float(c)) for c in corner)) for corner in (low, high)))

    def contains(self, p: Point3f) -> Bool:
        """True for points in the box."""
        return dr.all((p >= self.low) & (p <= self.high))

    def span(self, o: Point3f, d: Vector3f, length: Float, margin: Float | float = 0.0) -> tuple[Float, Float]:
        """The part of a segment in the box, `margin` wider on all sides; empty if the first number isn't lower."""
        start, end = Float(0), Float(length)
        for x, v, low, high in zip(o, d, self.low, self.high, strict=True):
            start, end = between(x, v, low - margin, high + margin, start, end)
        return start, end


@dataclass
class Segment:
    """What a capsule is about: a segment, or a point if its length is 0."""

    o: Point3f
    d: Vector3f
    """A unit vector."""
    length: Float


@dataclass
class Axis:
    """What a lane knows of one of its axes: of its segment, and of the grid."""

    o: Float
    d: Float
    low: Float
    width: Float
    inverse: Float
    last: Int32
    """The number of the last cell."""
    stride: UInt32

    def cell(self, c: Float) -> Int32:
        """The number of the cell that holds a coordinate, or the nearest one."""
        return Int32(dr.clip(dr.floor((c - self.low) * self.inverse), 0, Float(self.last)))

    def cells(self, start: Float, end: Float, radius: Float) -> tuple[Int32, Int32]:
        """The first and the last cell that part of the capsule reaches into."""
        here, there = dr.fma(self.d, start, self.o), dr.fma(self.d, end, self.o)
        return self.cell(dr.minimum(here, there) - radius), self.cell(dr.maximum(here, there) + radius)

    def part(self, number: Int32, radius: Float, start: Float, end: Float) -> tuple[Float, Float]:
        """The part of the segment from which the capsule reaches into cells of a number."""
        low = dr.fma(Float(number), self.width, self.low)
        first, last = between(self.o, self.d, low - radius, low + self.width + radius, start, end)
        return dr.minimum(first, end), dr.maximum(dr.minimum(first, end), last)


@dataclass
class Visit:
    """Loop state of a capsule that is noted in cells, slab by slab along the axis on which it is longest."""

    a: Int32
    b: Int32
    c: Int32
    first: list[Int32]
    """The first cells of the current slab along b and c."""
    last: list[Int32]


@dataclass
class March:
    """Loop state of a ray on its way through the cells."""

    cell: list[Int32]
    begin: Float
    """Where the ray enters the cell."""
    next: Vector3f
    """Where it would leave the cell along each axis."""
    i: UInt32
    """The next entry of the cell, and one past the last."""
    stop: UInt32
    entry: UInt32
    """The number of the last ball or capsule that was looked at."""
    found: Bool
    """True if the ray meets it."""
    active: Bool


class Cells:
    """Numbered balls or capsules of one radius, by the cells of a box that they reach into."""

    def __init__(self, box: Box, radius: Float) -> None:
        """Create an empty grid, of one cell; `fill` chooses how many there are.

        Args:
            box: what the grid covers.
            radius: that of the balls and capsules, 1-wide.
        """
        low, high = (np.array([c[0] for c in corner], np.float64) for corner in (box.low, box.high))
        self.box, self._radius = box, radius
        self._least = max(2 * float(radius[0]), 1e-30)
        self._sides = np.maximum(high - low, self._least)
        self._divide(1)
        self._begin, self._entries = dr.opaque(UInt32, 0, self._count + 1), dr.opaque(UInt32, 0, 1)

    def _divide(self, wanted: float) -> None:
        """Divide the box into about as many cells as are wanted; fewer if a ball would reach into many."""
        width = max(self._least, float(self._sides.prod() / min(max(wanted, 1), MOST_CELLS)) ** (1 / 3))
        counts = np.maximum(np.ceil(self._sides / width), 1).astype(int)
        self._count = int(counts.prod())
        self._widths = Vector3f(*(dr.opaque(Float, float(w)) for w in self._sides / counts))
        self._inverse = Vector3f(*(dr.opaque(Float, float(w)) for w in counts / self._sides))
        self._last = [dr.opaque(Int32, int(n) - 1) for n in counts]
        self._strides = [dr.opaque(UInt32, int(n)) for n in (1, counts[0], counts[0] * counts[1])]

    # ---- filling -----------------------------------------------------------------------

    def fill(self, count: int, segment: Callable[[UInt32], Segment]) -> None:
        """Note `count` balls or capsules, by the segments that they are about; those of a negative length are none.

        A segment of the length l passes through about 3/2 l / w cells of the width w: cells are as small as gives each
        of them one entry to look at, on average over the box.
        """
        if count:
            of = segment(dr.arange(UInt32, count) + dr.opaque(UInt32, 0))
            start, end = self.box.span(of.o, of.d, of.length, self._radius)
            within: Any = end - start
            pieces: Any = dr.count(within >= 0)
            lengths: Any = dr.sum(dr.maximum(within, 0))
            dr.eval(pieces, lengths)
            self._divide(cells_for(int(pieces[0]), float(lengths[0]), float(self._sides.prod())))
        counts = dr.opaque(UInt32, 0, self._count + 1)
        if count:
            self._visit(count, segment, lambda number, cell, there: dr.scatter_add(counts, UInt32(1), cell, there))
            dr.eval(counts)
        self._begin = dr.cumsum(counts) - counts
        dr.eval(self._begin)
        total = int(self._begin[self._count])
        self._entries = dr.empty(UInt32, max(total, 1))
        if total:
            place = self._begin + dr.opaque(UInt32, 0)  # a copy, which moves on
            dr.eval(place)

            def note(number: UInt32, cell: UInt32, there: Bool) -> None:
                at: Any = dr.scatter_inc(place, cell, there)
                dr.scatter(self._entries, number, at, there)

            self._visit(count, segment, note)
        dr.eval(self._entries)

    def _visit(
        self, count: int, segment: Callable[[UInt32], Segment], action: Callable[[UInt32, UInt32, Bool], None]
    ) -> None:
        """Do something for each cell that each capsule reaches into."""
        number = dr.arange(UInt32, count) + dr.opaque(UInt32, 0)
        of, radius = segment(number), self._radius * SLACK
        start, end = self.box.span(of.o, of.d, of.length, radius)
        there = start <= end
        moves = [dr.abs(c) * of.length for c in of.d]
        along_x = (moves[0] >= moves[1]) & (moves[0] >= moves[2])
        along_y = ~along_x & (moves[1] >= moves[2])
        order = (
            dr.select(along_x, UInt32(0), dr.select(along_y, UInt32(1), UInt32(2))),
            dr.select(along_x, UInt32(1), UInt32(0)),
            dr.select(along_x | along_y, UInt32(2), UInt32(1)),
        )
        a, b, c = (self._axis(of, axis) for axis in order)
        first, last = a.cells(start, end, radius)

        def across(slab: Int32) -> tuple[list[Int32], list[Int32]]:
            part = a.part(slab, radius, start, end)
            ranges = [axis.cells(*part, radius) for axis in (b, c)]
            return [r[0] for r in ranges], [r[1] for r in ranges]

        def step(visit: Visit) -> tuple[Visit]:
            action(number, UInt32(visit.a) * a.stride + UInt32(visit.b) * b.stride + UInt32(visit.c) * c.stride, there)
            row_ends = visit.c >= visit.last[1]
            slab_ends = row_ends & (visit.b >= visit.last[0])
            next_a = dr.select(slab_ends, visit.a + 1, visit.a)
            new_first, new_last = across(next_a)
            first = [dr.select(slab_ends, n, o) for n, o in zip(new_first, visit.first, strict=True)]
            last = [dr.select(slab_ends, n, o) for n, o in zip(new_last, visit.last, strict=True)]
            next_b = dr.select(slab_ends, first[0], dr.select(row_ends, visit.b + 1, visit.b))
            return (Visit(next_a, next_b, dr.select(row_ends, first[1], visit.c + 1), first, last),)

        begin_at, end_at = across(first)
        state = Visit(dr.select(there, first, last + 1), begin_at[0], begin_at[1], begin_at, end_at)
        (done,) = while_loop((wide(state, count),), lambda visit: visit.a <= last, step, label="cells of capsules")
        dr.eval(done.a)

    def _axis(self, of: Segment, number: UInt32) -> Axis:
        """A lane's axis by its number."""

        def pick(values: Any) -> Any:
            return dr.select(number == 0, values[0], dr.select(number == 1, values[1], values[2]))

        o, d, low, width, inverse = (pick(v) for v in (of.o, of.d, self.box.low, self._widths, self._inverse))
        return Axis(o, d, low, width, inverse, pick(self._last), pick(self._strides))

    # ---- rays --------------------------------------------------------------------------

    def meet(
        self,
        ray: Ray3f,
        length: Float,
        active: Bool,
        meets: Callable[[UInt32, Bool, Float, Float], Bool],
        add: Callable[[UInt32, Bool, Any], Any],
        total: Any,
    ) -> Any:
        """Add up something over the balls or capsules that a segment of a ray meets.

        Args:
            ray: the ray, with a unit direction.
            length: the length of the segment, which begins at the ray's origin; it may be infinite.
            active: lanes that have a sum.
            meets: whether the ray meets the ball or capsule of a number, where asked, and is nearest to what it is
                about at a distance of at least the first number given, and less than the second.
            add: the sum with one more ball or capsule, where there is one.
            total: the sum so far, a PyTree.
        """
        lanes = dr.width(ray, length, active, total)
        start, end = self.box.span(ray.o, ray.d, length)
        inverse = Vector3f(*(dr.rcp(dr.select(dr.abs(v) < STILL, STILL, v)) for v in ray.d))
        step = [dr.select(v > 0, Int32(1), Int32(-1)) for v in inverse]
        apart = dr.abs(inverse) * self._widths
        entry = dr.fma(ray.d, start, ray.o)
        first = [
            Int32(dr.clip(dr.floor((p - low) * per), 0, Float(most)))
            for p, low, per, most in zip(entry, self.box.low, self._inverse, self._last, strict=True)
        ]
        sides = Vector3f(*(Float(n + dr.select(s > 0, Int32(1), Int32(0))) for n, s in zip(first, step, strict=True)))
        following = (dr.fma(sides, self._widths, self.box.low) - ray.o) * inverse

        def run(cell: list[Int32], asked: Bool) -> tuple[UInt32, UInt32]:
            number = UInt32(cell[0]) + UInt32(cell[1]) * self._strides[1] + UInt32(cell[2]) * self._strides[2]
            return dr.gather(UInt32, self._begin, number, asked), dr.gather(UInt32, self._begin, number + 1, asked)

        def seek(march: March) -> tuple[March]:
            there = march.i < march.stop
            number = dr.gather(UInt32, self._entries, march.i, there)
            leaves = dr.minimum(march.next.x, dr.minimum(march.next.y, march.next.z))
            found = meets(number, there, march.begin, dr.minimum(leaves, end))
            i = dr.select(there, march.i + 1, march.i)
            # The next cell, where this one has no more entries.
            done = i >= march.stop
            x, y = done & (march.next.x <= leaves), done & (march.next.y <= leaves)
            y &= ~x
            z = done & ~x & ~y
            moved = [dr.select(by, n + s, n) for by, n, s in zip((x, y, z), march.cell, step, strict=True)]
            following = [dr.select(by, t + w, t) for by, t, w in zip((x, y, z), march.next, apart, strict=True)]
            on = ~done | (leaves < end)
            for n, most in zip(moved, self._last, strict=True):
                on &= (n >= 0) & (n <= most)
            start, stop = run(moved, done & on)
            return (
                March(
                    cell=moved,
                    begin=dr.select(done, leaves, march.begin),
                    next=Vector3f(*following),
                    i=dr.select(done, start, i),
                    stop=dr.select(done, stop, march.stop),
                    entry=number,
                    found=found,
                    active=on,
                ),
            )

        def body(march: March, total: Any) -> tuple[March, Any]:
            march = replace(march, found=dr.full(Bool, False, lanes))
            (march,) = while_loop((march,), lambda march: march.active & ~march.found, seek, label="cells of a ray")
            return march, add(march.entry, march.found, total)

        active = active & (start < end)
        i, stop = run(first, active)
        state = March(first, start, following, i, stop, UInt32(0), Bool(False), active)
        state = wide(state, lanes)
        _, total = while_loop((state, total), lambda march, total: march.active, body, label="what a ray meets")
        return total


def cells_for(pieces: int, length: float, volume: float) -> float:
    """The number n of cells to which `pieces` segments of a length in all make about n entries."""
    n = float(max(pieces, 1))
    for _ in range(ROUNDS):
        # n^(1/3) cells per side: the entries grow with the root of what they should be, so this converges.
        n = pieces + 1.5 * length * (n / volume) ** (1 / 3)
    return n


def between(o: Float, d: Float, low: Float, high: Float, start: Float, end: Float) -> tuple[Float, Float]:
    """The part of a segment of a ray, from `start` to `end`, with coordinates between two numbers."""
    inverse = dr.rcp(dr.select(dr.abs(d) < STILL, STILL, d))
    first, second = (low - o) * inverse, (high - o) * inverse
    return dr.maximum(start, dr.minimum(first, second)), dr.minimum(end, dr.maximum(first, second))
