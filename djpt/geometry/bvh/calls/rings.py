"""The search of a tree for all rays of a packet side by side, as functions in LLVM IR.

A search that finishes one ray before it begins the next (`djpt.geometry.bvh.calls.traversal`) spends half of its time
on branches that were predicted wrongly and on memory that hasn't come yet: how many children a ray meets, and where
they are, depends on the node before. Here no step of a ray waits for the step before it. The rays of a packet stand in
*rings*, queues of those that need the same kind of work next:

=======  ====================================================================================
ring     work
=======  ====================================================================================
nodes    test eight boxes; go on with one of the children that the ray meets
leaves   test eight triangles; go on with what the ray's stack holds
placed   test an analytic solid; enter an instance, or leave it
=======  ====================================================================================

A step takes the first ray of a ring, does one piece of work and puts the ray at the end of the ring that it needs next,
without a branch: an entry is written to every ring, and counts in one. The memory that the ray needs there is
prefetched, and arrives while other rays have their turn. What remains unpredictable is where a ring runs empty, and
whether a leaf was hit.

The work at a node is a pipeline of three stages, at a leaf of two: while the boxes of one ray are tested, the nearest
child of the ray before it is found, and the other children of the ray before that are put on its stack.

The stack of a ray isn't sorted. The nearest child goes on without it; when a hit is found, all entries that begin
farther away are taken off at once (`RingSearch.cut`), so that none has to be looked at again.

The functions have the interface of those for one ray after the other, and test boxes and triangles in the same way.
Packets of rays that run side by side are left to `djpt.geometry.bvh.calls.coherent`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from djpt.geometry.bvh.calls.coherent import CoherentSearch
from djpt.geometry.bvh.calls.layout import (
    ANY_HIT,
    CHILD_ROW,
    CHILDREN,
    LEAF,
    LEAF_ROWS,
    NUMBER_ROW,
    PLACED,
    REFERENCE,
    ROOT,
    ROW_BYTES,
)
from djpt.geometry.bvh.calls.ray import ROW, BoxRay, Features, Placed, PlaneRay, RayTerms, TriangleTest, Triple
from djpt.geometry.bvh.calls.traversal import (
    ANY,
    B1,
    B2,
    BLOCKED,
    FIELDS,
    INSIDE,
    PACKET,
    RECORD,
    STACK,
    lines_of,
    name_of,
)
from djpt.geometry.query import DETAIL
from djpt.jit.llvm.arithmetic import across_lanes, bit_count, lowest_bit, minimum, select
from djpt.jit.llvm.ir import F32, I1, I8, I16, I32, I64, LINE, Function, Module, Type, Value, vector

__all__ = ["RingSearch", "ring_function"]

WORDS, HALVES, MASK = vector(I32, CHILDREN), vector(I16, CHILDREN), vector(I1, CHILDREN)
"""Integers of 32 and 16 bits, and conditions, for each child of a node or triangle of a leaf."""

DONE, LEAVE = 0xFFFFFFFF, 0xFFFFFFFE
"""References on stacks: the search has ended; the ray comes out of an instance."""

NOWHERE = 0xFFFFFFFF
"""The distance, as bits, of what isn't on the way: of children that are missed, and of `DONE` and `LEAVE`. A NaN."""

LANES_OF_MASKS = [
    int.from_bytes(bytes(k for k in range(CHILDREN) if mask >> k & 1), "little") for mask in range(1 << CHILDREN)
]
"""For each mask of eight lanes the numbers of those that are set, a byte each."""

SLACK = 24
"""Entries that stacks have beyond those that count: a vector is written whole, and stacks whose distance were a
multiple of 1 KiB would compete for the same lines of the cache."""


def ring_function(kind: str, width: int, features: Features) -> str:
    """The search of a kind for packets of `width` rays, in LLVM's language.

    It has the name and parameters of `djpt.geometry.bvh.calls.traversal.packet_function`. The processor must have AVX2,
    and `width` be a power of two.
    """
    module = Module()
    with module.function(name_of(kind), PACKET) as f:
        # Either search computes the terms of rays: kept for the other, they would take the first one's registers.
        if not features.placed:
            CoherentSearch(f, kind == ANY, features, width).build()
        RingSearch(f, kind == ANY, features, width).build()
    return module.text()


# ---- queues ------------------------------------------------------------------------------------------------------


class Ring:
    """A queue of rays. An entry is a lane, in the upper half, and a reference."""

    def __init__(self, f: Function, width: int) -> None:
        """`width` is the largest number of rays, a power of two."""
        self._f, self._last_place = f, width - 1
        self._memory = f.array(I64, width)
        self._taken, self._offered = f.variable(I64, 0), f.variable(I64, 0)

    @property
    def count(self) -> Value:
        """The number of rays that wait."""
        return self._offered.value - self._taken.value

    def take(self) -> Value:
        """The entry that has waited longest. The ring mustn't be empty."""
        place = self._taken.value
        self._taken.value = place + 1
        return self._memory[place & self._last_place]

    def offer(self, entry: Value, condition: Value) -> None:
        """Add an entry if a condition holds, without a branch."""
        place = self._offered.value
        self._memory[place & self._last_place] = entry
        self._offered.value = place + condition.to(I64)


Stage = Callable[..., list[Value]]
"""Takes what the stage before it gives, for the same ray."""


class Pipeline:
    """Stages of work on the rays of a ring, at each time on a different ray in each stage.

    The first stage takes a ray from the ring, the last one puts it into a ring.
    """

    def __init__(self, f: Function, ring: Ring, stages: Sequence[tuple[Stage, Sequence[Type]]]) -> None:
        """A stage comes with the types of what it gives."""
        self._f, self._ring = f, ring
        self._stages = [stage for stage, _ in stages]
        self._kept = [[f.variable(type, 0) for type in types] for _, types in stages[:-1]]

    def run(self) -> None:
        """Work until the ring is empty and no ray is left in the stages."""
        f = self._f
        with f.loop() as turns:
            turns.stop_if(self._ring.count == 0)
            for filled in range(len(self._kept)):
                if filled:
                    with f.when(self._ring.count == 0):
                        self._drain(filled)
                        turns.again()
                self._advance(filled)
            with f.loop() as steps:
                steps.stop_if(self._ring.count == 0)
                self._advance(len(self._kept))
            self._drain(len(self._kept))

    def _advance(self, filled: int) -> None:
        """Take a ray, and move those in the first `filled` stages on by one stage."""
        taken = self._stages[0]()
        for stage in range(filled, 0, -1):
            self._keep(stage, self._stages[stage](*self._values(stage - 1)))
        self._keep(0, taken)

    def _drain(self, filled: int) -> None:
        """Finish the rays in the first `filled` stages, the oldest first."""
        for kept in range(filled - 1, -1, -1):
            values = self._values(kept)
            for stage in self._stages[kept + 1 :]:
                values = stage(*values)

    def _values(self, stage: int) -> list[Value]:
        return [variable.value for variable in self._kept[stage]]

    def _keep(self, stage: int, values: Sequence[Value]) -> None:
        if stage < len(self._kept):
            for variable, value in zip(self._kept[stage], values, strict=True):
                variable.value = value


# ---- the search --------------------------------------------------------------------------------------------------


class RingSearch:
    """The search for a packet of rays; the function for it is being built.

    What belongs to a ray lies in arrays with a number for each lane: its terms, its stack, and the tree in which it is.
    """

    def __init__(
        self,
        f: Function,
        any_hit: bool,
        features: Features,
        width: int,
        packet: tuple[Value, Value] | None = None,
    ) -> None:
        """`packet`: where it says which lanes are active, and where the rays are; by default as `f` is told."""
        self.f, self.any_hit, self.features, self.width = f, any_hit, features, width
        self.valid, self.scene, _, self.rays = f.parameters
        if packet is not None:
            self.valid, self.rays = packet
        self.row = vector(F32, width)
        terms = len(RayTerms.types())
        self.group_terms = terms * self.row.size
        """The bytes from the terms of a ray in the world to those in the space of an instance."""
        self.terms = f.reserve(self.row, terms * (2 if features.instances else 1))
        self.depth = STACK * (2 if features.instances else 1) + SLACK
        self.references, self.tops = f.array(I32, width * self.depth), f.array(I32, width)
        self.entries = None if any_hit else f.array(I32, width * self.depth)
        self.nodes, self.leaves, self.placed = (Ring(f, width) for _ in range(3))
        if features.instances:
            self.trees, self.instances = f.array(I64, width), f.array(I32, width)
            self.directions = f.reserve(self.row, 3)

    def build(self) -> None:
        """Let all rays begin at the root, and search."""
        self.begin()
        self.search()
        self.f.give()

    def search(self) -> None:
        """Work until all rings are empty."""
        f = self.f
        boxes = self.test_boxes, (I64, I32) if self.any_hit else (I64, I32, WORDS)
        nearest = [] if self.any_hit else [(self.find_nearest, (I64, I32, WORDS, I32))]
        at_nodes = Pipeline(f, self.nodes, [boxes, *nearest, (self.descend, ())])
        edges = self.test_edges, (I64, *(6 * [ROW]))
        at_leaves = Pipeline(f, self.leaves, [edges, (self.visit_leaf, ())])
        with f.loop() as turns:
            at_nodes.run()
            at_leaves.run()
            waiting = self.nodes.count
            if self.features.placed:
                self.visit_all_placed()
                waiting = self.nodes.count + self.leaves.count + self.placed.count
            turns.stop_if(waiting == 0)

    def begin(self) -> None:
        """Compute the terms of all rays, and let active ones wait for the root."""
        f, row = self.f, self.row
        for k, term in enumerate(RayTerms.of(*lines_of(self.rays, self.width)).values()):
            f.store(term, self.terms.at(row.size * k), row.size)
        with f.each(0, self.width) as lane:
            bottom = self.stack(lane)
            self.references[bottom] = DONE
            if self.entries is not None:
                self.entries[bottom] = NOWHERE
            self.tops[lane] = 1
            if self.features.instances:
                self.trees[lane] = 0
                self.instances[lane] = 0
            self.nodes.offer((lane << 32) | ROOT, f.load(I32, self.valid.at(lane * 4)) != 0)

    # ---- what belongs to a lane ------------------------------------------------------------------

    def number(self, field: str | int, lane: Value) -> Value:
        """The address of a lane's number in one of the packet's arrays."""
        index = FIELDS[field] if isinstance(field, str) else field
        return self.rays.at(lane * 4).at(4 * self.width * index)

    def maxt(self, lane: Value) -> Value:
        """The distance of a ray's closest hit so far, or of its end."""
        return self.f.load(F32, self.number("maxt", lane))

    def in_world(self, lane: Value) -> tuple[list[Value], list[Value]]:
        """The origin and the direction of a ray in the world."""
        o, d = ([self.f.load(F32, self.number(FIELDS[part] + axis, lane)) for axis in range(3)] for part in "od")
        return o, d

    def terms_of(self, lane: Value) -> RayTerms:
        """The terms of a ray in the space of the tree in which it is."""
        f, here = self.f, self.terms.at(lane * 4)
        if self.features.instances:
            here = here.at(select(self.instances[lane] == 0, f.constant(I64, 0), self.group_terms))
        return RayTerms.from_values(
            [f.load(type, here.at(self.row.size * k)) for k, type in enumerate(RayTerms.types())]
        )

    def tree_of(self, lane: Value) -> Value:
        """The start of the tree in which a ray is."""
        return self.scene.at(self.trees[lane]) if self.features.instances else self.scene

    def at_reference(self, entry: Value) -> Value:
        """The node or leaf of a ring's entry."""
        return self.tree_of(entry >> 32).at((entry & REFERENCE) * ROW_BYTES)

    def stack(self, lane: Value) -> Value:
        """The place of the lowest entry of a ray's stack."""
        return lane * self.depth

    def go_on(self, lane: Value, reference: Value) -> None:
        """Put a ray into the ring for its next reference; into none if it is DONE."""
        f, entry = self.f, (lane << 32) | reference.to(I64)
        self.nodes.offer(entry, reference < LEAF)
        self.leaves.offer(entry, (reference ^ LEAF) < (PLACED ^ LEAF))
        if self.features.placed:
            self.placed.offer(entry, (reference >= PLACED) & (reference != DONE))
        # A reference without a row leads to an address that may not exist, which a prefetch may name.
        address = self.at_reference(entry)
        for line in range(LEAF_ROWS * ROW_BYTES // LINE):
            f.prefetch(address.at(LINE * line))

    def pop(self, lane: Value) -> None:
        """Go on with the upper entry of a ray's stack."""
        top = self.tops[lane] - 1
        self.tops[lane] = top
        self.go_on(lane, self.references[self.stack(lane) + top.to(I64)])

    def push(self, lane: Value, reference: int) -> None:
        """Put a reference on a ray's stack that no hit takes off."""
        top = self.tops[lane]
        place = self.stack(lane) + top.to(I64)
        self.references[place] = reference
        if self.entries is not None:
            self.entries[place] = NOWHERE
        self.tops[lane] = top + 1

    # ---- nodes -------------------------------------------------------------------------------------

    def test_boxes(self) -> list[Value]:
        """The entry of a ray, the children that it meets, and how far away they are."""
        entry = self.nodes.take()
        lane = entry >> 32
        distance, met = BoxRay(self.f, self.terms_of(lane)).meet(self.at_reference(entry), self.maxt(lane))
        bits = met.bits_as(I8).to(I32)
        if self.any_hit:
            return [entry, bits]
        return [entry, bits, select(met, distance.bits_as(WORDS), NOWHERE)]

    def find_nearest(self, entry: Value, bits: Value, distances: Value) -> list[Value]:
        """The nearest child: the least of eight distances, of which 16 bits are compared."""
        # Distances aren't negative, so that their bits are sorted as they are; the sign is left out.
        upper = (distances >> 15).to(HALVES)
        least = self.f.intrinsic("x86.sse41.phminposuw", [upper], HALVES, suffix="")
        return [entry, bits, distances, least.lane(1).to(I32)]

    def descend(
        self, entry: Value, bits: Value, distances: Value | None = None, nearest: Value | None = None
    ) -> list[Value]:
        """Go on with the nearest child, or the first if any hit will do; the others wait on the stack."""
        f, lane = self.f, entry >> 32
        children = self.at_reference(entry).at(CHILD_ROW)
        # Of a ray that meets no child the reference isn't used.
        first = lowest_bit(bits | (1 << CHILDREN - 1)) if nearest is None else nearest
        rest = bits & (bits - 1) if nearest is None else bits & ~(f.constant(I32, 1) << nearest)
        top = self.tops[lane]
        place = self.stack(lane) + top.to(I64)
        below = self.references[place - 1]
        child = f.load(I32, children.at(first.to(I64) * 4))
        waiting = f.load(WORDS, children, align=ROW_BYTES)
        f.store(self.compressed(waiting, rest), self.references.place(place), align=4)
        if distances is not None and self.entries is not None:
            f.store(self.compressed(distances, rest), self.entries.place(place), align=4)
        self.tops[lane] = top + bit_count(bits) - 1
        self.go_on(lane, select(bits == 0, below, child))
        return []

    def compressed(self, words: Value, bits: Value) -> Value:
        """The words of the lanes that are set in a mask, one after the other; unspecified behind them."""
        f = self.f
        orders = f.table("lanes_of_masks", I64, LANES_OF_MASKS)
        order = f.load(vector(I8, CHILDREN), orders.at((bits & 0xFF).to(I64) * 8), align=8)
        return f.intrinsic("x86.avx2.permd", [words, order.to(WORDS)], WORDS, suffix="")

    # ---- leaves --------------------------------------------------------------------------------------

    def test_edges(self) -> list[Value]:
        """The entry of a ray, and what it has computed for eight triangles up to the division."""
        entry = self.leaves.take()
        test = PlaneRay(self.f, self.terms_of(entry >> 32)).meet(self.at_reference(entry))
        return [entry, *test.edges, *test.heights]

    def visit_leaf(self, entry: Value, *numbers: Value) -> list[Value]:
        """Note the closest of eight triangles that a ray hits."""
        f, lane = self.f, entry >> 32
        x, y, z = numbers[:3]
        test = TriangleTest((x, y, z), numbers[3:], self.terms_of(lane).shear[2])
        t, *weights = test.distance()
        hit = test.inside & (t > 0.0) & (t < self.maxt(lane))
        hits = hit.bits_as(I8).to(I32)
        with f.when(hits != 0):
            if self.features.lights or self.features.one_sided:
                stopping = self.stopping(entry, hits)
                with f.when(stopping != 0):
                    self.take_closest(entry, stopping, t, weights)
            else:
                self.take_closest(entry, hits, t, weights)
        self.pop(lane)
        return []

    def stopping(self, entry: Value, hits: Value) -> Value:
        """The triangles in a mask through which a ray doesn't pass."""
        f, features, lane = self.f, self.features, entry >> 32
        leaf, flags = self.at_reference(entry), f.load(I32, self.number("flags", lane))
        d = self.direction_of(lane)
        remaining, stopping = f.variable(I32, hits), f.variable(I32, hits)
        with f.loop() as candidates:
            bits = remaining.value
            candidates.stop_if(bits == 0)
            remaining.value = bits & (bits - 1)
            record = self.record_of(lane, leaf, lowest_bit(bits))
            passes = features.passed(f, self.scene, record, flags) if features.lights else f.constant(I1, 0)
            if features.one_sided:
                passes = passes | features.behind(f, self.scene, record, d)
            stopping.value = stopping.value ^ select(passes, bits ^ remaining.value, 0)
        return stopping.value

    def direction_of(self, lane: Value) -> Sequence[Value]:
        """The direction of a ray in the space of the tree in which it is."""
        world = self.in_world(lane)[1]
        if not self.features.instances:
            return world
        own = [self.f.load(F32, self.directions.at(lane * 4).at(self.row.size * axis)) for axis in range(3)]
        outside = self.instances[lane] == 0
        return [select(outside, x, y) for x, y in zip(world, own, strict=True)]

    def record_of(self, lane: Value, leaf: Value, slot: Value) -> Value:
        """The record of a leaf's triangle."""
        number = self.f.load(I32, leaf.at(NUMBER_ROW).at(slot.to(I64) * 4))
        return number + self.f.load(I32, self.tree_of(lane))

    def take_closest(self, entry: Value, hits: Value, t: Value, weights: Sequence[Value]) -> None:
        """Note the closest of the triangles in a mask, the first of several that are equally far away."""
        f, lane = self.f, entry >> 32
        if self.any_hit:
            return self.block(lane)
        hit = hits.to(I8).bits_as(MASK)
        distances = select(hit, t, float("inf"))
        least = across_lanes(distances, minimum)
        slot = lowest_bit((hit & (distances == least)).bits_as(I8).to(I32))
        b1, b2 = (f.array(F32, CHILDREN) for _ in range(2))
        b1.store(weights[0])
        b2.store(weights[1])
        record = self.record_of(lane, self.at_reference(entry), slot)
        self.note(lane, least.lane(0), (b1[slot], b2[slot]), record)
        return None

    # ---- hits ------------------------------------------------------------------------------------------

    def block(self, lane: Value) -> None:
        """Note that a ray is blocked, which ends its search."""
        self.f.store(self.f.constant(F32, BLOCKED), self.number("maxt", lane))
        self.tops[lane] = 1

    def note(self, lane: Value, t: Value, weights: Sequence[Value], record: Value) -> None:
        """Note the closest hit of a ray so far, and take what lies behind it from its stack."""
        f = self.f
        for value, field in ((t, "maxt"), (weights[0], B1), (weights[1], B2), (record, RECORD)):
            f.store(value, self.number(field, lane))
        # The kernel will read the record.
        f.prefetch(self.scene.at(record.to(I64) * ROW_BYTES))
        inside = self.instances[lane] if self.features.instances else f.constant(I32, 0)
        f.store(inside, self.number(INSIDE, lane))
        with f.either((f.load(I32, self.number("flags", lane)) & ANY_HIT) != 0) as branch:
            self.tops[lane] = 1
            branch.otherwise()
            self.cut(lane, t)

    def cut(self, lane: Value, t: Value) -> None:
        """Take all entries that begin at `t` or farther away from a ray's stack."""
        f, bottom, count = self.f, self.stack(lane), self.tops[lane]
        assert self.entries is not None
        read, written = f.variable(I64, 0), f.variable(I64, 0)
        with f.loop() as blocks:
            source, target = bottom + read.value, bottom + written.value
            entries = f.load(WORDS, self.entries.place(source), align=4)
            references = f.load(WORDS, self.references.place(source), align=4)
            exists = (f.constants(I32, range(CHILDREN)) + read.value.to(I32).spread(CHILDREN)) < count
            # What has no distance stays.
            kept = (~(entries.bits_as(ROW) >= t) & exists).bits_as(I8).to(I32)
            f.store(self.compressed(entries, kept), self.entries.place(target), align=4)
            f.store(self.compressed(references, kept), self.references.place(target), align=4)
            written.value = written.value + bit_count(kept).to(I64)
            read.value = read.value + CHILDREN
            blocks.stop_if(read.value >= count.to(I64))
        self.tops[lane] = written.value.to(I32)

    # ---- placed primitives -----------------------------------------------------------------------------

    def visit_all_placed(self) -> None:
        """Test solids, and enter and leave instances, until the ring is empty."""
        f = self.f
        with f.loop() as turns:
            turns.stop_if(self.placed.count == 0)
            entry = self.placed.take()
            lane, reference = entry >> 32, entry.to(I32)
            if self.features.instances:
                with f.either(reference == LEAVE) as branch:
                    self.trees[lane] = 0
                    self.instances[lane] = 0
                    branch.otherwise()
                    self.visit_placed(lane, reference)
            else:
                self.visit_placed(lane, reference)
            self.pop(lane)

    def visit_placed(self, lane: Value, reference: Value) -> None:
        """Enter an instance, or test an analytic solid."""
        placed = Placed.of(self.f, self.scene, reference)
        o, d = placed.into(*self.in_world(lane))
        detail = placed.word(DETAIL)
        placed.visit(
            self.features,
            lambda: self.visit_solid(lane, placed, detail, o, d),
            lambda: self.enter_instance(lane, placed, detail, o, d),
        )

    def enter_instance(self, lane: Value, placed: Placed, row: Value, o: Triple, d: Triple) -> None:
        """Let a ray begin at the root of an instance's group, whose tree starts at a row, and come back."""
        f, size = self.f, self.row.size
        terms = self.terms.at(lane * 4).at(self.group_terms)
        for k, term in enumerate(RayTerms.of(o, d).values()):
            f.store(term, terms.at(size * k))
        for axis in range(3):
            f.store(d[axis], self.directions.at(lane * 4).at(size * axis))
        self.trees[lane] = row.to(I64) * ROW_BYTES
        self.instances[lane] = placed.record
        self.push(lane, LEAVE)
        self.push(lane, ROOT)

    def visit_solid(self, lane: Value, placed: Placed, kind: Value, o: Triple, d: Triple) -> None:
        """Test a solid of one of the scene's kinds."""
        f, features = self.f, self.features
        for hit, t in placed.hits(features.kinds, kind, o, d):
            counts = hit & (t > 0.0) & (t < self.maxt(lane))
            if features.lights:
                flags = f.load(I32, self.number("flags", lane))
                counts = counts & ~features.passed(f, self.scene, placed.record, flags)
            with f.when(counts):
                if self.any_hit:
                    self.block(lane)
                else:
                    nothing = f.constant(F32, 0.0)
                    self.note(lane, t, (nothing, nothing), placed.record)
