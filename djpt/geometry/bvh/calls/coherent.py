"""The search of a tree for rays that run side by side, with one stack for all rays of a packet, in LLVM IR.

Camera rays of neighbouring pixels visit nearly the same nodes. Here a node is visited once for all rays of a packet.
Its eight children are tested together against the packet as a whole, a range of origins and a range of directions;
those that are left are tested one by one, with the lanes of a vector for the rays (I. Wald, P. Slusallek, C. Benthin
and M. Wagner, "Interactive Rendering with Coherent Ray Tracing", 2001; A. Reshetov, A. Soupikov and J. Hurley,
"Multi-Level Ray Tracing Algorithm", 2005). So are the triangles of a leaf.

Whether a packet is coherent is found out for each packet, by few instructions. Others are searched by
`djpt.geometry.bvh.calls.rings`, and find the same hits: single rays are tested by the same instructions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce

from djpt.geometry.bvh.calls.layout import (
    CHILD_ROW,
    CHILDREN,
    EXTENT_WORD,
    LEAF,
    NODE_ROWS,
    NUMBER_ROW,
    REFERENCE,
    ROOT,
    ROW_BYTES,
)
from djpt.geometry.bvh.calls.packet_hits import Packet, PacketHits
from djpt.geometry.bvh.calls.ray import ROW, Features, RayTerms, TriangleTest, overlap
from djpt.geometry.bvh.calls.traversal import STACK
from djpt.jit.llvm.arithmetic import abs, across_lanes, any_of, bit_count, fma, lowest_bit, maximum, minimum, select
from djpt.jit.llvm.ir import F32, I8, I32, I64, LINE, Function, Loop, Type, Value

__all__ = ["CoherentSearch"]

SPREAD = 0.1
"""How far directions may differ, relative to their longest component, and origins, relative to the tree's radius."""

FINEST = 0.08
"""The least size of triangles, relative to the width of a packet where it passes the middle of the tree.

Among smaller ones each ray would need nodes and leaves of its own.
"""

SLACK = 2.0**-20
"""The relative rounding errors that the tests of whole packets allow for."""

NONE = 0xFFFFFFFF
"""No child."""


class CoherentSearch(Packet):
    """The search for coherent packets; the function is being built."""

    def __init__(self, f: Function, any_hit: bool, features: Features, width: int) -> None:
        super().__init__(f, any_hit, features, width)
        self.terms = RayTerms.of(self.o, self.d)

    def build(self) -> None:
        """Search for a packet that is coherent and return; go on with what is built next for others."""
        f, terms = self.f, self.terms
        lanes = self.active.bits_as(Type("i", self.width)).to(I32)
        with f.when(bit_count(lanes) >= self.width // 2):
            first = lowest_bit(lanes)

            def same(values: Sequence[Value]) -> Value:
                return reduce(lambda a, b: a & b, [x == x.lane(first).spread(self.width) for x in values])

            def apart(values: Sequence[Value]) -> Value:
                return reduce(maximum, [abs(x - x.lane(first).spread(self.width)) for x in values])

            length = reduce(maximum, [abs(x.lane(first)) for x in self.d])
            radius, size = (f.load(F32, self.scene.at(4 * (EXTENT_WORD + k))) for k in range(2))
            spread, shift = apart(self.d), apart(self.o)
            # Coordinates count from the middle of the tree.
            distance = reduce(maximum, [abs(x.lane(first)) for x in self.o])
            narrow = spread * (distance / length) + shift <= size * (1 / FINEST)
            close = (spread <= length * SPREAD) & (shift <= radius * SPREAD)
            coherent = same([*terms.near, *terms.axes]) & close & narrow
            with f.when(~any_of(~coherent & self.active)):
                PacketSearch(self, first, radius).build()
                f.give()


class Beam:
    """All rays of a packet, as ranges: a test that a box passes if any of them may meet it."""

    def __init__(self, search: CoherentSearch, near: Sequence[Value], radius: Value) -> None:
        """`near` are the bytes to the planes that all rays come to first."""

        def ends(x: Value) -> tuple[Value, Value]:
            low, high = (select(search.active, x, end) for end in (float("inf"), float("-inf")))
            return across_lanes(low, minimum).lane(0), across_lanes(high, maximum).lane(0)

        self.inverse = [[end.spread(CHILDREN) for end in ends(x)] for x in search.terms.inverse]
        ranges = [ends(x) for x in search.o]
        # Tests of triangles round relative to coordinates, at most those of the origin and of the tree.
        margin = reduce(maximum, [abs(x) for pair in ranges for x in pair], radius) * SLACK
        ahead = [near[a] == 2 * ROW_BYTES * a for a in range(3)]
        low, high = ([x - margin for x, _ in ranges], [x + margin for _, x in ranges])
        self.ahead = ahead
        self.first = [select(ahead[a], high[a], low[a]).spread(CHILDREN) for a in range(3)]
        self.last = [select(ahead[a], low[a], high[a]).spread(CHILDREN) for a in range(3)]

    def meets(self, near: Sequence[Value], far: Sequence[Value], reach: Value) -> Value:
        """A mask, as an integer, of the boxes between planes that some ray may meet before `reach`."""

        def extreme(
            planes: Sequence[Value], origin: Sequence[Value], choose: Callable[[Value, Value], Value]
        ) -> list[Value]:
            return [
                choose((planes[a] - origin[a]) * self.inverse[a][0], (planes[a] - origin[a]) * self.inverse[a][1])
                for a in range(3)
            ]

        enter = reduce(maximum, extreme(near, self.first, minimum)[::-1])
        leave = reduce(minimum, [*extreme(far, self.last, maximum), reach.spread(CHILDREN)])
        return (maximum(enter, 0.0) <= leave * (1 + SLACK)).bits_as(I8).to(I32)


class PacketSearch:
    """The search for the rays of a packet that is coherent."""

    def __init__(self, packet: CoherentSearch, first: Value, radius: Value) -> None:
        """`first` is a lane that is active."""
        f, terms = packet.f, packet.terms
        self.f, self.packet, self.terms = f, packet, terms
        self.near = [x.lane(first).to(I64) for x in terms.near]
        self.far = [x ^ ROW_BYTES for x in self.near]
        self.axes = [x.lane(first).to(I64) for x in terms.axes]
        self.beam = Beam(packet, self.near, radius)
        self.hits = PacketHits(packet)
        self.reach = f.variable(F32, across_lanes(self.hits.limit.value, maximum).lane(0))
        """The largest of the limits."""
        self.references, self.distances = f.array(I32, STACK), f.array(packet.row, STACK)
        self.top = f.variable(I64, 0)
        self.current = f.variable(I32, ROOT)

    def build(self) -> None:
        """Visit nodes and leaves until the stack is empty, and write the results."""
        f = self.f
        with f.loop() as search:
            with f.loop() as descent:
                descent.stop_if(self.current.value >= LEAF)
                self.descend(descent, search)
            self.visit_leaf(search)
            self.pop(search, search)
        self.hits.write()

    def at(self, reference: Value) -> Value:
        """The node or leaf of a reference."""
        return self.packet.scene.at((reference & REFERENCE).to(I64) * ROW_BYTES)

    # ---- nodes -------------------------------------------------------------------------------------

    def descend(self, descent: Loop, search: Loop) -> None:
        """Go on with the nearest child that any ray meets; the others wait on the stack."""
        f, node = self.f, self.at(self.current.value)
        planes = [[f.load(ROW, node.at(rows[a]), align=ROW_BYTES) for a in range(3)] for rows in (self.near, self.far)]
        remaining = f.variable(I32, self.beam.meets(planes[0], planes[1], self.reach.value))
        nearest, distance = f.variable(I32, NONE), f.variable(self.packet.row, float("inf"))
        with f.loop() as children:
            bits = remaining.value
            children.stop_if(bits == 0)
            slot = lowest_bit(bits).to(I64) * 4
            remaining.value = bits & (bits - 1)
            entry, met = self.meet(node, slot)
            children.again_if(~any_of(met))
            child = f.load(I32, node.at(CHILD_ROW).at(slot))
            address = self.at(child)
            for line in range(NODE_ROWS * ROW_BYTES // LINE):
                f.prefetch(address.at(LINE * line))
            entry = select(met, entry, float("inf"))
            with f.when(nearest.value == NONE):
                nearest.value = child
                distance.value = entry
                children.again()
            with f.either(any_of(entry < distance.value)) as branch:
                self.push(nearest.value, distance.value)
                nearest.value = child
                distance.value = entry
                branch.otherwise()
                self.push(child, entry)
        with f.when(nearest.value == NONE):
            self.pop(descent, search)
        self.current.value = nearest.value

    def meet(self, node: Value, slot: Value) -> tuple[Value, Value]:
        """Where the rays enter a child, and which of them meet it."""
        f, terms, width = self.f, self.terms, self.packet.width

        def distances(rows: Sequence[Value]) -> list[Value]:
            planes = [f.load(F32, node.at(rows[a]).at(slot)).spread(width) for a in range(3)]
            return [fma(planes[a], terms.inverse[a], terms.shift[a]) for a in range(3)]

        return overlap(distances(self.near), distances(self.far), self.hits.limit.value)

    def push(self, reference: Value, distance: Value) -> None:
        """Let a child wait."""
        place = self.top.value
        self.references[place] = reference
        self.distances[place] = distance
        self.top.value = place + 1

    def pop(self, onward: Loop, search: Loop) -> None:
        """Go on with the next child that some ray enters before its closest hit; end the search if there is none."""
        f = self.f
        with f.loop():
            count = self.top.value
            with f.when(count == 0):
                search.stop()
            self.top.value = count - 1
            self.current.value = self.references[count - 1]
            onward.again_if(any_of(self.distances[count - 1] < self.hits.limit.value))

    # ---- leaves ------------------------------------------------------------------------------------

    def visit_leaf(self, search: Loop) -> None:
        """Test the triangles whose boxes some ray may meet, one by one."""
        f, leaf = self.f, self.at(self.current.value)
        corners = [[f.load(ROW, leaf.at(ROW_BYTES * (3 * k + a)), align=ROW_BYTES) for k in range(3)] for a in range(3)]
        low, high = ([reduce(choose, corners[a]) for a in range(3)] for choose in (minimum, maximum))
        near, far = ([select(self.beam.ahead[a], x[a], y[a]) for a in range(3)] for x, y in ((low, high), (high, low)))
        remaining = f.variable(I32, self.beam.meets(near, far, self.reach.value))
        with f.loop() as triangles:
            bits = remaining.value
            triangles.stop_if(bits == 0)
            slot = lowest_bit(bits).to(I64) * 4
            remaining.value = bits & (bits - 1)
            test = self.test(leaf, slot)
            # No branch: whether any ray hits can't be predicted.
            t, *weights = test.distance()
            hit = test.inside & (t > 0.0) & (t < self.hits.limit.value)
            record = f.load(I32, leaf.at(NUMBER_ROW).at(slot)) + f.load(I32, self.packet.scene)
            if self.packet.features.lights or self.packet.features.one_sided:
                triangles.again_if(~any_of(hit))
                hit = hit & ~self.hits.passes(record)
            self.hits.note(hit, t, weights, record.spread(self.packet.width))
            if self.packet.any_hit:
                search.stop_if(~any_of(self.hits.limit.value > 0.0))
            else:
                # The kernel will read the record.
                f.prefetch(self.packet.scene.at(record.to(I64) * ROW_BYTES))
        self.reach.value = across_lanes(self.hits.limit.value, maximum).lane(0)

    def test(self, leaf: Value, slot: Value) -> TriangleTest:
        """Test one triangle with all rays."""
        f, width = self.f, self.packet.width

        def coordinate(corner: int, axis: Value) -> Value:
            return f.load(F32, leaf.at(axis).at(3 * ROW_BYTES * corner).at(slot)).spread(width)

        return TriangleTest.of(coordinate, self.axes, self.terms.origin, self.terms.shear)
