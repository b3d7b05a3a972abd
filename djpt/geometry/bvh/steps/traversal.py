"""Traversal of the BVH, one step at a time.

A step is the same for every lane, whatever it does: load the current record, test four boxes and one
triangle, move on. A lane at a node ignores the triangle's result, a lane at a triangle the boxes', and
a lane that has finished spins on the empty record. There are no branches and no masks, so a step can
be unrolled and repeated, in a loop of its own (`djpt.geometry.bvh.steps.trees`) or in a larger one
(`djpt.rendering.schedules.machine`).

The stack lives in registers: one word per level of the tree, shifted by selects.

docs/theory/acceleration.md explains the layout; docs/performance.md what each part gains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from djpt.geometry.bvh.steps.records import (
    CELL,
    CHILD,
    EMITS,
    EMPTY,
    EXIT,
    LEAF,
    NUMBER,
    ONE_SIDED,
    PORTAL,
    ROOT,
    SOLID,
    Records,
)
from djpt.geometry.canonical import intersect
from djpt.geometry.query import NONE
from djpt.geometry.triangle import RayPlane, TriangleHit, intersect_triangle
from djpt.jit.kernels import float_in, if_stmt, maximum, minimum, while_loop
from djpt.jit.types import ArrayXu, Bool, Float, Point2f, Point3f, UInt32, Vector3f

__all__ = [
    "Cursor",
    "into_group",
    "load",
    "load_second",
    "reciprocal",
    "start",
    "triangle_corners",
    "turn",
    "visit",
]

UNROLLED = 2
"""Steps that are taken without testing whether any lane is still at work."""

ROUNDS = 4
"""The number of times that a turn takes `UNROLLED` steps; a lane that finishes waits for the end of the turn."""

INFINITY = 0x7F800000
"""The bits of +inf. The bits of non-negative floats are ordered like the floats."""

MAGIC = 0x4B000000
"""The bits of 2^23; with a 16-bit number n in the lower half they are those of 2^23 + n."""


@dataclass
class Passage:
    """A lane's way through instances: loop state."""

    o: Point3f
    """The ray's origin in the space that the lane is in: that of an instance, or the world's."""
    d: Vector3f
    inside: UInt32
    """The record of the instance that the lane is in, or NONE."""
    hit_inside: UInt32
    """The record of the instance that the hit belongs to, or NONE."""


@dataclass
class Cursor:
    """The progress of a lane in its traversal: loop state."""

    current: UInt32
    """The record to visit next; EMPTY when finished."""
    stack: list[UInt32]
    """The children still to visit, per level: first child << 9 | up to three tags of 3 bits, nearest lowest."""
    t: Float
    """The distance of the closest hit so far, or of the ray's end."""
    hit: UInt32
    """The record of the triangle at `t`, or NONE."""
    b: Point2f | None = None
    """Barycentric weights of the second and third corner at the hit; None if they aren't needed."""
    waiting: Bool | None = None
    """Whether the lane has come to a portal; None in scenes without portals."""
    passage: Passage | None = None
    """The lane's way through instances; None in scenes without instances."""

    @property
    def ended(self) -> Bool:
        """True where the search has come to its end."""
        return self.current == EMPTY

    @property
    def inside(self) -> UInt32 | None:
        """The record of the instance that the hit belongs to, or NONE; None in scenes without instances."""
        return None if self.passage is None else self.passage.hit_inside


def start(
    records: Records,
    o: Point3f,
    d: Vector3f,
    maxt: Float,
    active: Bool | bool,
    hit: UInt32 | int = NONE,
    weights: bool = False,
) -> Cursor:
    """A cursor at the root; finished where not `active`. `hit` is what was hit before, at `maxt`.

    With `weights` it keeps barycentric weights.
    """
    # A ray with NaN would enter all boxes, also those of missing children.
    reach = dr.abs(o.x) + dr.abs(o.y) + dr.abs(o.z)
    usable = (reach < 1e18) & dr.isfinite(d.x + d.y + d.z) & active
    root: Any = dr.select(usable, UInt32(ROOT), UInt32(EMPTY))
    stack = [UInt32(0) for _ in range(records.depth)]
    passage = Passage(Point3f(o), Vector3f(d), UInt32(NONE), UInt32(NONE)) if records.instanced else None
    waiting = Bool(False) if records.instanced or records.kinds else None
    return Cursor(root, stack, Float(maxt), UInt32(hit), Point2f(0) if weights else None, waiting, passage)


def visit(
    records: Records, cursor: Cursor, o: Point3f, d: Vector3f, any_hit: Bool, through_lights: Bool | None = None
) -> Cursor:
    """Take one step of a ray, with the crossing into or out of an instance that it leads to.

    Where `any_hit`, the first triangle hit ends the search; where `through_lights`, triangles that emit
    aren't hit.
    """
    stepper = stepper_for(records, cursor, o, d)
    return crossed(records, stepper.step(cursor, any_hit, through_lights), o, d, any_hit, through_lights)


def turn(
    records: Records, cursor: Cursor, o: Point3f, d: Vector3f, any_hit: Bool, through_lights: Bool | None = None
) -> Cursor:
    """Take `UNROLLED` x `ROUNDS` steps of a ray; the arguments are those of `visit`."""
    stepper = stepper_for(records, cursor, o, d)

    def steps(cursor: Cursor, any_hit: Bool) -> Cursor:
        for _ in range(UNROLLED):
            cursor = stepper.step(cursor, any_hit, through_lights)
        return cursor

    # A loop, though the number of rounds is known: unrolled, the code outgrows the processor's caches.
    cursor, _, _ = while_loop(
        (cursor, UInt32(0), any_hit),
        lambda cursor, i, any_hit: (i < ROUNDS) & going(cursor),
        lambda cursor, i, any_hit: (steps(cursor, any_hit), i + 1, any_hit),
        label="steps",
    )
    return crossed(records, cursor, o, d, any_hit, through_lights)


def stepper_for(records: Records, cursor: Cursor, o: Point3f, d: Vector3f) -> Stepper:
    """The stepper for the ray o, d of the world, in the space that the lane is in."""
    passage = cursor.passage
    return Stepper(records, o, d) if passage is None else Stepper(records, passage.o, passage.d)


def going(cursor: Cursor) -> Bool:
    """Whether there is a step to take."""
    return cursor.current != EMPTY if cursor.waiting is None else (cursor.current != EMPTY) & ~cursor.waiting


def crossed(
    records: Records, cursor: Cursor, o: Point3f, d: Vector3f, any_hit: Bool, through_lights: Bool | None
) -> Cursor:
    """Do what the cursor is waiting for, if anything: test an analytic shape, or cross a portal."""
    if cursor.waiting is None:
        return cursor

    def cross(cursor: Cursor) -> tuple[Cursor]:
        words = load(records.words, cursor.current)
        placed = into_group(words, o, d)
        back, popped = advance(cursor, UInt32(0), [UInt32(INFINITY)] * 4, None)
        after = replace(cursor, current=back, stack=popped, waiting=Bool(False))
        if records.kinds:
            after = test_solid(records, after, cursor.current, words, placed, any_hit, through_lights)
        if cursor.passage is not None:
            after = dr.select((words[12] & SOLID) != 0, after, pass_portal(cursor, after, words, placed, o, d))
        return (after,)

    (cursor,) = if_stmt((cursor,), cursor.waiting, cross, lambda cursor: (cursor,))
    return cursor


def test_solid(
    records: Records,
    cursor: Cursor,
    record: UInt32,
    words: list[UInt32],
    ray: tuple[Point3f, Vector3f],
    any_hit: Bool,
    through_lights: Bool | None,
) -> Cursor:
    """Test the analytic shape at `record`, which the cursor has passed already; `ray` is in the shape's space."""
    hit, t = intersect(records.kinds, words[13], *ray, cursor.t, [float_in(word) for word in words[14:16]])
    hit &= (words[12] & SOLID) != 0
    if through_lights is not None:
        hit &= ~(through_lights & ((words[12] & EMITS) != 0))
    passage = cursor.passage
    if passage is not None:
        passage = replace(passage, hit_inside=dr.select(hit, NONE, passage.hit_inside))
    return replace(
        cursor,
        current=dr.select(hit & any_hit, UInt32(EMPTY), cursor.current),
        t=dr.select(hit, t, cursor.t),
        hit=dr.select(hit, record, cursor.hit),
        passage=passage,
    )


def pass_portal(
    cursor: Cursor, after: Cursor, words: list[UInt32], placed: tuple[Point3f, Vector3f], o: Point3f, d: Vector3f
) -> Cursor:
    """Go into the instance at the current record, or out of the one that the lane is in.

    `after` is the cursor past the record, `placed` the ray in the space of the instance, o, d in the world.
    """
    passage = cursor.passage
    assert passage is not None
    out = (words[12] & NUMBER) == NUMBER
    # Below the group's tree on the stack lies the record that leads out of the instance.
    pushed = [UInt32((EXIT << 9) | 4), *cursor.stack[:-1]]
    return replace(
        cursor,
        current=dr.select(out, after.current, words[13]),
        stack=[dr.select(out, a, b) for a, b in zip(after.stack, pushed, strict=True)],
        waiting=Bool(False),
        passage=replace(
            passage,
            o=dr.select(out, o, placed[0]),
            d=dr.select(out, d, placed[1]),
            inside=dr.select(out, UInt32(NONE), cursor.current),
        ),
    )


def into_group(words: list[UInt32], o: Point3f, d: Vector3f) -> tuple[Point3f, Vector3f]:
    """Map a ray into the space of the group that an instance's record names; distances stay the same."""
    m = [float_in(word) for word in words[:12]]
    rows = [(Vector3f(m[4 * i], m[4 * i + 1], m[4 * i + 2]), m[4 * i + 3]) for i in range(3)]
    return Point3f(*(dr.dot(row, o) + shift for row, shift in rows)), Vector3f(*(dr.dot(row, d) for row, _ in rows))


def load(words: UInt32, record: UInt32) -> list[UInt32]:
    """Load the 16 words of a record by two packet loads."""
    first: Any = dr.gather(ArrayXu, words, record * 2, shape=(8, 1))
    return [*first, *load_second(words, record)]


def load_second(words: UInt32, record: UInt32) -> list[UInt32]:
    """Load words 8 to 15 of a record."""
    second: Any = dr.gather(ArrayXu, words, record * 2 + 1, shape=(8, 1))
    return list(second)


def triangle_corners(words: list[UInt32]) -> tuple[Point3f, Point3f, Point3f]:
    """The corners in a triangle's record."""
    x = [float_in(w) for w in words[:9]]
    return Point3f(x[0:3]), Point3f(x[3:6]), Point3f(x[6:9])


def reciprocal(d: Vector3f) -> Vector3f:
    """1 / d, with zeros replaced by tiny numbers: inf * 0 would arise where the origin lies in a plane of a box."""
    return Vector3f(*(dr.rcp(dr.select(dr.abs(x) < 1e-18, dr.copysign(Float(1e-18), x), x)) for x in d))


class Stepper:
    """Steps along a ray; holds what doesn't change from step to step."""

    def __init__(self, records: Records, o: Point3f, d: Vector3f) -> None:
        """`o` is relative to the records' centre: see `enter`."""
        self.records, self.o, self.d = records, o, d
        self.plane = RayPlane(o, d)
        self.inv = reciprocal(d)
        # The half of a word that holds the near plane.
        self.near_shift = [dr.select(x < 0, UInt32(16), UInt32(0)) for x in self.inv]
        self.far_shift = [16 - shift for shift in self.near_shift]

    def step(self, cursor: Cursor, any_hit: Bool, through_lights: Bool | None) -> Cursor:
        """Visit one record."""
        words = load(self.records.words, cursor.current)
        passage, leaf = cursor.passage, words[12] >= LEAF
        order = self._boxes(words, dr.select(leaf, Float(-1), cursor.t))

        found = self._triangle(words)
        portal = None if cursor.waiting is None else words[12] >= LEAF | PORTAL
        hit = (leaf if portal is None else leaf & ~portal) & found.hit & (found.t > 0) & (found.t < cursor.t)
        if through_lights is not None:
            hit &= ~(through_lights & ((words[12] & EMITS) != 0))
        if self.records.one_sided:
            n = Vector3f(*(float_in(word) for word in words[9:12]))
            hit &= ~(((words[12] & ONE_SIDED) != 0) & (dr.dot(n, self.d) > 0))
        t = dr.select(hit, found.t, cursor.t)
        record = dr.select(hit, cursor.current, cursor.hit)

        current, stack = advance(cursor, words[12] & CHILD, order, portal)
        current = dr.select(hit & any_hit, UInt32(EMPTY), current)
        b = None if cursor.b is None else dr.select(hit, Point2f(found.b1, found.b2), cursor.b)
        if passage is not None:
            passage = replace(passage, hit_inside=dr.select(hit, passage.inside, passage.hit_inside))
        return Cursor(current, stack, t, record, b, portal, passage)

    def _triangle(self, words: list[UInt32]) -> TriangleHit:
        return intersect_triangle(self.plane, *triangle_corners(words))

    def _boxes(self, words: list[UInt32], reach: Float) -> list[UInt32]:
        """The four children in the order of their entry distances, as tagged integers; misses are INFINITY."""
        cell: Any = dr.reinterpret_array(Float, words[12] & CELL)
        offset, scale = [], []
        for axis in range(3):
            origin: Any = dr.reinterpret_array(Float, words[13 + axis])
            s = cell * self.inv[axis]
            # The 2^23 that `plane_number` adds is subtracted here, once per axis.
            offset.append(dr.fma(Float(-8388608.0), s, (origin - self.o[axis]) * self.inv[axis]))
            scale.append(s)
        order = []
        for child in range(4):
            near, far = [], []
            for axis in range(3):
                planes = words[3 * child + axis]
                near.append(dr.fma(plane_number(planes, self.near_shift[axis]), scale[axis], offset[axis]))
                far.append(dr.fma(plane_number(planes, self.far_shift[axis]), scale[axis], offset[axis]))
            entry = maximum(maximum(near[0], near[1]), maximum(near[2], Float(0)))
            leave = minimum(minimum(far[0], far[1]), minimum(far[2], reach))
            bits: Any = dr.reinterpret_array(UInt32, entry)
            tag = (bits & 0xFFFFFFF8) | (4 + child)
            order.append(dr.select(entry <= leave, tag, UInt32(INFINITY)))
        for i, j in ((0, 1), (2, 3), (0, 2), (1, 3), (1, 2)):
            order[i], order[j] = dr.minimum(order[i], order[j]), dr.maximum(order[i], order[j])
        return order


def plane_number(word: UInt32, shift: UInt32) -> Float:
    """One half of a word as a float, plus 2^23: reinterpreted, without a conversion."""
    number: Any = dr.reinterpret_array(Float, ((word >> shift) & 0xFFFF) | MAGIC)
    return number


def advance(cursor: Cursor, first_child: UInt32, order: list[UInt32], stay: Bool | None) -> tuple[UInt32, list[UInt32]]:
    """The next record and stack: down to the nearest child, else the stack's next entry; unchanged where `stay`."""
    down, several = order[0] < INFINITY, order[1] < INFINITY
    top: Any = cursor.stack[0]
    remaining = (top & 511) >> 3
    leaving = ~down if stay is None else ~down & ~stay
    popped = leaving & (remaining == 0)
    # The lower two bits of a tag are the child's number.
    from_stack = dr.select(cursor.current == EMPTY, UInt32(EMPTY), (top >> 9) + (top & 3))
    current = dr.select(down, first_child + (order[0] & 3), from_stack)
    if stay is not None:
        current = dr.select(stay, cursor.current, current)

    entry = (first_child << 9) | (order[1] & 7) | ((order[2] & 7) << 3) | ((order[3] & 7) << 6)
    kept = dr.select(leaving, (top & 0xFFFFFE00) | remaining, top)
    stack = [*cursor.stack, UInt32(0)]
    shifted = [dr.select(several, entry, dr.select(popped, stack[1], kept))]
    for level in range(1, len(cursor.stack)):
        shifted.append(dr.select(several, stack[level - 1], dr.select(popped, stack[level + 1], stack[level])))
    return current, shifted
