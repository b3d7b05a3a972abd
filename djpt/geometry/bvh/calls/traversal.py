"""The search of a tree for one ray, and for packets of rays, as functions in LLVM IR.

A node's eight boxes are tested at once, and so are the triangles of a leaf: the lanes of a vector are the
children of one node, not the rays of a packet as in `djpt.geometry.bvh.steps.traversal`. So rays needn't wait for each
other, however different they are (I. Wald, C. Benthin and S. Boulos, "Getting Rid of Packets", 2008).

The children that a ray meets wait on a stack, the nearest on top. An entry is the distance at which the
ray enters a child, in the upper half, and the reference: sorted as whole numbers, entries are
sorted by distance, since distances aren't negative.

Kernels call functions with a packet of rays. Dr.Jit calls them as it would call Embree: with a mask, a pointer to the
scene, a context, and the rays as one array per field, with a number for each lane of the packet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from djpt.geometry.bvh.calls.ray import BoxRay, Features, Placed, PlaneRay, RayTerms, TriangleTest, Triple
from djpt.geometry.query import DETAIL
from djpt.jit.llvm.arithmetic import any_of, lowest_bit, select
from djpt.jit.llvm.ir import F32, I8, I32, I64, LINE, PTR, Function, Loop, Module, Type, Value, Variable, vector

__all__ = [
    "ANY",
    "CLOSEST",
    "FIELDS",
    "Hit",
    "Rays",
    "add_search",
    "lines_of",
    "name_of",
    "packet_function",
]

CLOSEST, ANY = "closest", "any"
"""The kinds of searches: for the first hit, or whether there is one."""

STACK = 512
"""Entries of the stack: seven for each level that a builder may make, and the last node's."""

FIELDS = {"o": 0, "d": 4, "maxt": 8, "flags": 9}
"""The first array of each part of a ray, among those of Dr.Jit's packets."""


@dataclass
class Hit:
    """The addresses to which a search writes the closest hit: five words side by side."""

    t: Value
    b1: Value
    b2: Value
    record: Value
    inside: Value

    @staticmethod
    def at(address: Value) -> Hit:
        """The words from an address on."""
        return Hit(*(address.at(4 * k) for k in range(5)))


@dataclass
class Rays:
    """A packet of rays: arrays with a number for each lane."""

    memory: Value
    """The arrays of `FIELDS`, one after the other."""
    terms: Value
    """The arrays of `RayTerms.values`."""
    width: int

    def read(self, lane: Value) -> Ray:
        """The ray of a lane."""
        f = lane.function

        def number(type: Type, array: Value, index: int) -> Value:
            return f.load(type, array.at((lane + index * self.width) * 4))

        o, d = ([number(F32, self.memory, FIELDS[part] + axis) for axis in range(3)] for part in "od")
        maxt, flags = number(F32, self.memory, FIELDS["maxt"]), number(I32, self.memory, FIELDS["flags"])
        terms = [number(type, self.terms, k) for k, type in enumerate(RayTerms.types())]
        return Ray(o, d, maxt, flags, RayTerms.from_values(terms))


@dataclass
class Ray:
    """One ray."""

    o: Sequence[Value]
    d: Sequence[Value]
    maxt: Value
    flags: Value
    terms: RayTerms


def add_search(module: Module, kind: str, features: Features, width: int) -> None:
    """Add a search for one ray of a packet to a module.

    The function's name is the kind. Its parameters are the start of the scene's block, the two memories of
    `Rays`, the lane, and for CLOSEST the address of a `Hit`. It returns whether there is a hit.
    """
    out = [("out", PTR)] if kind == CLOSEST else []
    if features.instances:
        ray = [(f"{part}{axis}", F32) for part in "od" for axis in "xyz"]
        parameters = [("scene", PTR), ("tree", PTR), *ray, ("maxt", F32), ("flags", I32), *out]
        with module.function(in_group(kind), parameters, I32, internal=True) as f:
            scene, tree, *numbers = f.parameters[:10]
            o, d = numbers[:3], numbers[3:6]
            inner = Ray(o, d, numbers[6], numbers[7], RayTerms.of(o, d))
            Search(f, kind, replace(features, instances=False, kinds=()), scene, tree, inner).build()
    parameters = [("scene", PTR), ("rays", PTR), ("terms", PTR), ("lane", I64), *out]
    with module.function(kind, parameters, I32, internal=True) as f:
        scene, rays, terms, lane = f.parameters[:4]
        Search(f, kind, features, scene, scene, Rays(rays, terms, width).read(lane)).build()


def in_group(kind: str) -> str:
    """The name of the function that searches the tree of an instance's group."""
    return f"{kind}_in_group"


class Search:
    """A search that is being built."""

    def __init__(self, f: Function, kind: str, features: Features, scene: Value, tree: Value, ray: Ray) -> None:
        """`features` are those of the tree, which begins at `tree`; `scene` is where records count from."""
        self.f, self.any_hit, self.features = f, kind == ANY, features
        self.scene, self.tree, self.ray = scene, tree, ray
        self.reach: Variable = f.variable(F32, ray.maxt)
        """The distance of the closest hit so far, or of the ray's end."""
        self.found = f.variable(I32, 0)
        self.current = f.variable(I32, ROOT)
        self.stack, self.top = f.array(I64, STACK), f.variable(I64, 0)
        self.entries = f.array(F32, CHILDREN)
        self.out = None if self.any_hit else f.parameters[-1]

    def build(self) -> None:
        """Visit nodes and leaves until the stack is empty."""
        f = self.f
        boxes, planes = BoxRay(f, self.ray.terms), PlaneRay(f, self.ray.terms)
        with f.loop() as search:
            with f.loop() as descent:
                child = self.current.value
                descent.stop_if(child >= LEAF)
                node = self.tree.at(child.to(I64) * ROW_BYTES)
                entry, met = boxes.meet(node, self.reach.value)
                self.descend(node, entry, met.bits_as(I8).to(I32), descent, search)
            child = self.current.value
            if self.features.placed:
                with f.when(child >= PLACED):
                    self.visit_placed(child)
                    self.pop(search, search)
            leaf = self.tree.at((child & REFERENCE).to(I64) * ROW_BYTES)
            self.visit_leaf(leaf, planes.meet(leaf))
            self.pop(search, search)
        f.give(self.found.value)

    # ---- nodes -------------------------------------------------------------------------------

    def descend(self, node: Value, entry: Value, met: Value, descent: Loop, search: Loop) -> None:
        """Go on with the nearest of the children in the mask `met`; the others wait on the stack."""
        f, children = self.f, node.at(CHILD_ROW)
        with f.when(met == 0):
            self.pop(descent, search)
        first, rest = lowest_bit(met), met & (met - 1)
        first_child = f.load(I32, children.at(first.to(I64) * 4))
        with f.when(rest == 0):
            self.current.value = first_child
            descent.again()
        self.entries.store(entry)

        def waiting(slot: Value, child: Value) -> Value:
            bits = f.load(I32, self.entries.place(slot.to(I64)))
            return (bits.to(I64) << 32) | child.to(I64)

        second, rest = lowest_bit(rest), rest & (rest - 1)
        second_child = f.load(I32, children.at(second.to(I64) * 4))
        self.prefetch(first_child, second_child)
        a = waiting(first, first_child)
        b = waiting(second, second_child)
        near, far = select(a < b, a, b), select(a < b, b, a)
        base = self.top.value
        self.stack[base] = far
        with f.when(rest == 0):
            self.top.value = base + 1
            self.current.value = near.to(I32)
            descent.again()
        self.stack[base + 1] = near
        self.top.value = base + 2
        remaining = f.variable(I32, rest)
        with f.loop() as more:
            bits = remaining.value
            slot = lowest_bit(bits)
            child = f.load(I32, children.at(slot.to(I64) * 4))
            self.prefetch(child)
            self.insert(base, waiting(slot, child))
            remaining.value = bits & (bits - 1)
            more.stop_if(remaining.value == 0)
        last = self.top.value - 1
        self.top.value = last
        self.current.value = self.stack[last].to(I32)

    def prefetch(self, *children: Value) -> None:
        """Ask for the memory of children that have to wait for each other."""
        for child in children:
            address = self.tree.at((child & REFERENCE).to(I64) * ROW_BYTES)
            for line in range(LEAF_ROWS * ROW_BYTES // LINE):
                self.f.prefetch(address.at(LINE * line))

    def insert(self, base: Value, entry: Value) -> None:
        """Put an entry on the stack, above all that are farther among those from `base` on."""
        f = self.f
        place = f.variable(I64, self.top.value)
        self.top.value = place.value + 1
        with f.loop() as shift:
            shift.stop_if(place.value <= base)
            below = self.stack[place.value - 1]
            shift.stop_if(below >= entry)
            self.stack[place.value] = below
            place.value = place.value - 1
        self.stack[place.value] = entry

    def pop(self, onward: Loop, search: Loop) -> None:
        """Go on with the next child on the stack that begins before the closest hit; end the search if none does."""
        f = self.f
        with f.loop():
            count = self.top.value
            with f.when(count == 0):
                search.stop()
            entry = self.stack[count - 1]
            self.top.value = count - 1
            self.current.value = entry.to(I32)
            if self.any_hit:
                onward.again()
            else:
                distance = (entry >> 32).to(I32).bits_as(F32)
                onward.again_if(distance < self.reach.value)

    # ---- leaves ------------------------------------------------------------------------------

    def visit_leaf(self, leaf: Value, test: TriangleTest) -> None:
        """Test eight triangles, and note the closest that is hit."""
        f = self.f
        with f.when(any_of(test.inside)):
            t, b1, b2 = test.distance()
            hit = test.inside & (t > 0.0) & (t < self.reach.value)
            hits = hit.bits_as(I8).to(I32)
            with f.when(hits != 0):
                if self.any_hit and not (self.features.lights or self.features.one_sided):
                    f.give(1)
                else:
                    self.take_closest(leaf, hits, t, (b1, b2))

    def take_closest(self, leaf: Value, hits: Value, t: Value, weights: Sequence[Value]) -> None:
        """Note the closest of the triangles in the mask `hits`."""
        f, remaining = self.f, self.f.variable(I32, hits)
        numbers = [f.array(F32, CHILDREN) for _ in range(3)]
        for array, values in zip(numbers, (t, *weights), strict=True):
            array.store(values)
        with f.loop() as candidates:
            bits = remaining.value
            candidates.stop_if(bits == 0)
            slot = lowest_bit(bits).to(I64)
            remaining.value = bits & (bits - 1)
            distance = numbers[0][slot]
            candidates.again_if(~(distance < self.reach.value))
            record = f.load(I32, leaf.at(NUMBER_ROW).at(slot * 4)) + f.load(I32, self.tree)
            if self.features.lights:
                candidates.again_if(self.passed(record))
            if self.features.one_sided:
                candidates.again_if(self.features.behind(f, self.scene, record, self.ray.d))
            if self.any_hit:
                f.give(1)
            else:
                self.reach.value = distance
                self.found.value = 1
                assert self.out is not None
                out = Hit.at(self.out)
                for value, place in ((distance, out.t), (numbers[1][slot], out.b1), (numbers[2][slot], out.b2)):
                    f.store(value, place)
                f.store(record, out.record)
                f.store(f.constant(I32, 0), out.inside)

    def passed(self, record: Value) -> Value:
        """Whether the ray passes through a shape since it is part of a light."""
        return self.features.passed(self.f, self.scene, record, self.ray.flags)

    # ---- placed primitives -------------------------------------------------------------------

    def visit_placed(self, child: Value) -> None:
        """Go into an instance, or test an analytic solid."""
        placed = Placed.of(self.f, self.scene, child)
        o, d = placed.into(self.ray.o, self.ray.d)
        detail = placed.word(DETAIL)
        placed.visit(
            self.features,
            lambda: self.visit_solid(placed, detail, o, d),
            lambda: self.visit_instance(placed, detail, o, d),
        )

    def visit_instance(self, placed: Placed, root: Value, o: Triple, d: Triple) -> None:
        """Search the group's tree, whose block begins at the row `root`."""
        f = self.f
        tree = self.scene.at(root.to(I64) * ROW_BYTES)
        results = [] if self.out is None else [self.out]
        name = in_group(ANY if self.any_hit else CLOSEST)
        hit = f.call(name, [self.scene, tree, *o, *d, self.reach.value, self.ray.flags, *results], I32)
        assert hit is not None
        with f.when(hit != 0):
            if self.out is None:
                f.give(1)
            else:
                out = Hit.at(self.out)
                self.reach.value = f.load(F32, out.t)
                self.found.value = 1
                f.store(placed.record, out.inside)

    def visit_solid(self, placed: Placed, kind: Value, o: Triple, d: Triple) -> None:
        """Test a solid of one of the scene's kinds."""
        f = self.f
        for hit, t in placed.hits(self.features.kinds, kind, o, d):
            counts = hit & (t > 0.0) & (t < self.reach.value)
            if self.features.lights:
                counts = counts & ~self.passed(placed.record)
            with f.when(counts):
                if self.any_hit:
                    f.give(1)
                else:
                    self.note(t, placed.record)

    def note(self, t: Value, record: Value) -> None:
        """Note the hit of a solid as the closest."""
        self.reach.value = t
        self.found.value = 1
        assert self.out is not None
        out, zero = Hit.at(self.out), self.f.constant(I32, 0)
        for value, place in ((t, out.t), (zero, out.b1), (zero, out.b2), (record, out.record), (zero, out.inside)):
            self.f.store(value, place)


# ---- packets -----------------------------------------------------------------------------------------------------


def name_of(kind: str) -> str:
    """The name of the function that searches for packets."""
    return f"{kind}_of_packet"


B1, B2, RECORD, INSIDE = 15, 16, 17, 18
"""The arrays for the closest hit, with `maxt` for its distance. A value in INSIDE tells Dr.Jit that there is one."""

PACKET = [("valid", PTR), ("scene", PTR), ("context", PTR), ("rays", PTR)]
"""The functions' parameters."""

BLOCKED = float("-inf")
"""The `maxt` of a ray that is blocked, for Dr.Jit."""


def packet_function(kind: str, width: int, features: Features) -> str:
    """The search of a kind for packets of `width` rays, in LLVM's language."""
    module = Module()
    # Any hit may be enough for single rays of a packet that looks for the closest.
    for needed in (ANY,) if kind == ANY else (ANY, CLOSEST):
        add_search(module, needed, features, width)
    with module.function(name_of(kind), PACKET) as f:
        Packet(f, width).search(kind)
    return module.text()


def lines_of(rays: Value, width: int) -> tuple[list[Value], list[Value]]:
    """The origins and the directions of a packet's rays, vectors with a lane for each ray."""
    f, row = rays.function, vector(F32, width)
    o, d = ([f.load(row, rays.at(4 * width * (FIELDS[part] + axis)), row.size) for axis in range(3)] for part in "od")
    return o, d


class Packet:
    """A packet of rays; the function for it is being built."""

    def __init__(self, f: Function, width: int) -> None:
        self.f, self.width = f, width
        self.valid, self.scene, _, self.rays = f.parameters
        self.found = f.array(I32, 5)

    def search(self, kind: str) -> None:
        """Search for one ray after the other."""
        f, terms = self.f, self.terms()
        with f.each(0, self.width) as lane, f.when(f.load(I32, self.valid.at(lane * 4)) != 0):
            arguments = [self.scene, self.rays, terms, lane]
            if kind == ANY:
                self.search_any(arguments, lane)
            else:
                flags = f.load(I32, self.field("flags", lane))
                with f.either((flags & ANY_HIT) != 0) as branch:
                    self.search_any(arguments, lane, keeps_distance=True)
                    branch.otherwise()
                    self.search_closest(arguments, lane)

    def terms(self) -> Value:
        """The address of the terms of all rays, computed at once for the whole packet."""
        f, row = self.f, vector(F32, self.width)
        values = RayTerms.of(*lines_of(self.rays, self.width)).values()
        memory = f.reserve(row, len(values))
        for k, value in enumerate(values):
            f.store(value, memory.at(row.size * k), row.size)
        return memory

    def search_any(self, arguments: list[Value], lane: Value, keeps_distance: bool = False) -> None:
        """Look for any hit; it is reported by the distance, or like a closest hit without a place."""
        f = self.f
        hit = f.call(ANY, arguments, I32)
        assert hit is not None
        with f.when(hit != 0):
            if keeps_distance:
                f.store(f.constant(I32, 1), self.field(RECORD, lane))
                f.store(f.constant(I32, 0), self.field(INSIDE, lane))
            else:
                f.store(f.constant(F32, BLOCKED), self.field("maxt", lane))

    def search_closest(self, arguments: list[Value], lane: Value) -> None:
        """Look for the closest hit and write it to its lane."""
        f, found = self.f, self.found.address
        hit = f.call(CLOSEST, [*arguments, found], I32)
        assert hit is not None
        with f.when(hit != 0):
            out = Hit.at(found)
            targets: tuple[str | int, ...] = ("maxt", B1, B2, RECORD, INSIDE)
            for source, target in zip((out.t, out.b1, out.b2, out.record, out.inside), targets, strict=True):
                f.store(f.load(I32, source), self.field(target, lane))

    def field(self, field: str | int, lane: Value) -> Value:
        """The address of a lane's number in an array."""
        index = FIELDS[field] if isinstance(field, str) else field
        return self.rays.at((lane + index * self.width) * 4)
