"""The construction of a binary tree, as functions in LLVM's language, and the records that it works on.

Top-down, by the surface area heuristic over binned centroids: I. Wald, "On fast Construction of SAH-based
Bounding Volume Hierarchies", 2007. A leaf holds up to eight triangles, which a ray tests all at once. So what
counts is the number of leaves, not of triangles.

Every node owns a range of the primitives, which `part` moves to another buffer, left from the front,
right from the back: there are two buffers, one for even and one for odd levels of the tree. All results are
exact minima, maxima and counts, so that they depend on no order of execution.

Primitives and nodes begin with a box of eight floats: low x, y, z, a word, **minus** high x, y, z, a word. One
minimum of eight lanes then joins two boxes, and low - (-high) is twice the centroid. Integers between the floats are
kept as the bits of ordinary floats, see `stored`.
"""

from __future__ import annotations

from dataclasses import dataclass

from djpt.jit.llvm.arithmetic import bit_length, maximum, minimum, select
from djpt.jit.llvm.ir import F32, I32, I64, PTR, Array, Function, Module, Operand, Value, Variable, vector

__all__ = [
    "ALONE",
    "BIAS",
    "BINS",
    "BOX",
    "CORNERS_SIZE",
    "COSTS",
    "COUNT",
    "EMPTY",
    "INNER",
    "LEAF_SIZE",
    "MERGED",
    "NODE_SIZE",
    "PLACED_COUNT",
    "POINT",
    "PRIMITIVE_SIZE",
    "SMALL",
    "Node",
    "add_build_functions",
    "area",
    "join",
    "parts",
    "stored",
]

BOX, POINT = vector(F32, 8), vector(F32, 4)

EMPTY = 1e30
"""All lanes of a box that holds nothing."""

BIAS = 0x40000000
"""Added to integers: small ones would be denormal floats, which slow down the arithmetic of their vector."""

PRIMITIVE_SIZE = 32
"""Bytes of a primitive: its box with the stored number of the triangle (or placed primitive), and ALONE or 0."""

ALONE = -1.0
"""The last lane of primitives that take a whole leaf; so also of every box that holds one."""

NODE_SIZE = 64
"""Bytes of a binary node.

======  ======================  ======================================================
word    while it is a leaf      once it is an inner node
======  ======================  ======================================================
0 .. 2  low corner of the box   the same
3       first primitive         the left child; the right one is the next node
4 .. 6  minus the high corner   the same
7       count of primitives     INNER, MERGED + count or SMALL + count
8 ..    centroids' low corner,  `COSTS`: seven floats, see `collapse_functions`
11      level,
12 ..   centroids' high corner
======  ======================  ======================================================

Leaves get costs in the end, too. A leaf that is a placed primitive has its number in word 3 and the count PLACED_COUNT.
"""

COSTS = 32

LEAF_SIZE = 8
"""The most triangles of a leaf."""

PLACED_COUNT, INNER, MERGED, SMALL = 9, 15, 16, 32
"""What stands in place of the count: a placed primitive; an inner node of many triangles; and, added to the count, an
inner node of few that is better as a leaf if it gets but one slot, and one that isn't."""

COUNT = 15
"""The bits of the count of a small node; more than fit into a leaf for all others."""


class Node:
    """A binary node in memory."""

    def __init__(self, function: Function, nodes: Value, index: Value) -> None:
        self._function, self._place = function, nodes.at(index * NODE_SIZE)

    @property
    def box(self) -> Value:
        """The box, with words 3 and 7 in their lanes."""
        return self._function.load(BOX, self._place)

    @property
    def centroids(self) -> tuple[Value, Value]:
        """The bounds of twice the centroids; the last lanes are of no use."""
        return self._function.load(POINT, self._place.at(32)), self._function.load(POINT, self._place.at(48))

    def set_bounds(self, box: Value, low: Value, high: Value) -> None:
        """Write the box and the bounds of the centroids; overwrites all integers."""
        for value, offset in ((box, 0), (low, 32), (high, 48)):
            self._function.store(value, self._place.at(offset))

    @property
    def costs(self) -> Value:
        """The costs for one slot up to seven; the last lane is of no use."""
        return self._function.load(BOX, self._place.at(COSTS))

    @costs.setter
    def costs(self, value: Value) -> None:
        self._function.store(value, self._place.at(COSTS))

    def cost(self, slots: Value) -> Value:
        """The cost for a number of slots."""
        return self._function.load(F32, self._place.at(slots * 4 + (COSTS - 4)))

    def _integer(self, word: int) -> Value:
        return self._function.load(I32, self._place.at(4 * word)).to(I64) - BIAS

    def _set_integer(self, word: int, value: Operand) -> None:
        self._function.store(stored(self._function, value), self._place.at(4 * word))

    @property
    def first(self) -> Value:
        """The first primitive, or the left child."""
        return self._integer(3)

    @first.setter
    def first(self, value: Operand) -> None:
        self._set_integer(3, value)

    @property
    def count(self) -> Value:
        """The number of primitives, INNER or PLACED_COUNT."""
        return self._integer(7)

    @count.setter
    def count(self, value: Operand) -> None:
        self._set_integer(7, value)

    @property
    def is_inner(self) -> Value:
        """Whether the node, which must be finished, has children."""
        return self.count >= INNER

    @property
    def is_merged(self) -> Value:
        """Whether the node has children, and is a leaf if it gets but one slot."""
        return (self.count & ~COUNT) == MERGED

    @property
    def level(self) -> Value:
        """The levels above the node, before it has costs."""
        return self._integer(11)

    @level.setter
    def level(self, value: Operand) -> None:
        self._set_integer(11, value)


def stored(function: Function, value: Operand) -> Value:
    """An integer in the form that has its place among floats."""
    return (function.constant(I64, value) + BIAS).to(I32)


def parts(box: Value) -> tuple[Value, Value]:
    """The corners of a box: low, and minus high."""
    return box.shuffled(range(4)), box.shuffled(range(4, 8))


def join(a: Value, b: Value) -> Value:
    """The smallest box about two."""
    return minimum(a, b)


def area(box: Value) -> Value:
    """Half the surface area of a box."""
    low, minus_high = parts(box)
    # Minus the extent; in the products the sign cancels.
    x = low + minus_high
    products = x.shuffled([0, 1, 2, 0]) * x.shuffled([1, 2, 0, 0])
    return (products.lane(0) + products.lane(1)) + products.lane(2)


BINS = 16
FEW, FEW_BINS = 8, 8
"""Up to so many primitives need fewer bins."""

CORNERS_SIZE = 36
"""Bytes of a triangle's corners."""

DIVIDE = 0.3
"""A few triangles are split only if that saves such a fraction of their cost. Too many splits do no harm, see
`collapse_functions`, but take time."""

FULL = 1.0
"""A node is a leaf without further ado if its triangles' boxes together have so much of its area."""

ROUNDING = 0.5
"""The weight of full leaves in the estimate of the number of leaves."""

STACK = 64

STATE = [("nodes", PTR), ("even", PTR), ("odd", PTR), ("sorted", PTR), ("deepest", I64)]
"""The parameters that the functions share: the binary nodes, the two buffers of primitives, the numbers of the
primitives in the order of the leaves, and the limit of levels."""


def add_build_functions(module: Module) -> None:
    """Add `bounds`, `prepare`, `split` and `grow` to a module."""
    add_prepare(module, "bounds", keep=False)
    add_prepare(module, "prepare", keep=True)
    add_part(module)
    add_split(module)
    add_grow(module)


# ---- primitives ---------------------------------------------------------------------------------------


@dataclass
class Bounds:
    """The bounds of some primitives and of their centroids."""

    box: Variable
    low: Variable
    high: Variable

    @staticmethod
    def empty(f: Function) -> Bounds:
        return Bounds(f.variable(BOX, EMPTY), f.variable(POINT, 2 * EMPTY), f.variable(POINT, -2 * EMPTY))

    def add(self, box: Value, where: Value | None = None) -> None:
        """Include a primitive, or only if a condition holds, given in all lanes."""
        low, minus_high = parts(box)
        centroid = low - minus_high
        for bound, value, combine in (
            (self.box, box, join),
            (self.low, centroid, minimum),
            (self.high, centroid, maximum),
        ):
            old = bound.value
            new = combine(old, value)
            bound.value = new if where is None else select(where.shuffled(range(old.type.lanes)), new, old)


def add_prepare(module: Module, name: str, keep: bool) -> None:
    """Compute the bounds of a range of triangles; if `keep`, also write their records."""
    parameters = [("corners", PTR), ("first", I64), ("end", I64), ("records", PTR), ("result", PTR)]
    with module.function(name, parameters) as f:
        corners, first, end, records, result = f.parameters
        bounds = Bounds.empty(f)
        with f.each(first, end) as i:
            triangle = corners.at(i * CORNERS_SIZE)
            # Four lanes from the start of the third corner would reach beyond the last triangle.
            third = f.load(POINT, triangle.at(20)).shuffled([1, 2, 3, 3])
            points = [f.load(POINT, triangle), f.load(POINT, triangle.at(12)), third]
            low = minimum(points[0], minimum(points[1], points[2]))
            high = maximum(points[0], maximum(points[1], points[2]))
            box = low.shuffled(range(8), -high)
            bounds.add(box)
            if keep:
                record = records.at(i * PRIMITIVE_SIZE)
                f.store(box, record)
                f.store(stored(f, i), record.at(12))
                f.store(f.constant(F32, 0.0), record.at(28))
        for bound, offset in ((bounds.box, 0), (bounds.low, 32), (bounds.high, 48)):
            f.store(bound.value, result.at(offset))


# ---- splits -------------------------------------------------------------------------------------------


@dataclass
class Grid:
    """The slabs of equal thickness, along all axes, into which a node's centroids are sorted."""

    count: Value
    origin: Value
    inverse: Value
    """Slabs per unit of length, 0 along axes on which all centroids are equal."""

    @staticmethod
    def of(low: Value, high: Value, count: Value) -> Grid:
        """The grid of centroids within some bounds."""
        extent = high - low
        # Slightly less than the number of slabs: the largest centroid belongs to the last one.
        slabs = (count.to(F32) * 0.9999).spread(4)
        return Grid(count, low, select(extent > 1e-34, slabs / extent, 0.0))

    def slabs(self, box: Value) -> Value:
        """The slabs of a primitive, one for each axis."""
        low, minus_high = parts(box)
        return (((low - minus_high) - self.origin) * self.inverse).whole()


@dataclass
class Bins:
    """The boxes and numbers of the primitives in every slab, axis after axis."""

    boxes: Array
    counts: Array

    @staticmethod
    def filled(f: Function, grid: Grid, source: Value, first: Value, end: Value) -> Bins:
        """Sort a range of primitives into the slabs."""
        bins = Bins(f.array(BOX, 3 * BINS), f.array(I32, 3 * BINS))
        with f.each(0, grid.count) as slab:
            for axis in range(3):
                bins.boxes[slab + axis * BINS] = EMPTY
                bins.counts[slab + axis * BINS] = 0
        # Neighbours often share a slab, and then wait for each other: take turns between the halves of the range.
        half = (end - first) >> 1
        with f.each(first, first + half) as i:
            bins.add(grid, f.load(BOX, source.at(i * PRIMITIVE_SIZE)))
            bins.add(grid, f.load(BOX, source.at((i + half) * PRIMITIVE_SIZE)))
        with f.when(((end - first) & 1) == 1):
            bins.add(grid, f.load(BOX, source.at((end - 1) * PRIMITIVE_SIZE)))
        return bins

    def add(self, grid: Grid, box: Value) -> None:
        """Include a primitive."""
        slabs = grid.slabs(box)
        for axis in range(3):
            at = slabs.lane(axis).to(I64) + axis * BINS
            self.boxes[at] = join(self.boxes[at], box)
            self.counts[at] = self.counts[at] + 1


class Sweep:
    """The box and number of all primitives up to a slab, seen from one end of an axis."""

    def __init__(self, f: Function, bins: Bins, axis: int) -> None:
        self._bins, self._axis = bins, axis
        self._box, self._count = f.variable(BOX, EMPTY), f.variable(I32, 0)

    def cost(self, slab: Value, leaf_bits: Value) -> Value:
        """Include a slab; then the cost of a node of these primitives, not a number if there are none."""
        at = slab + self._axis * BINS
        self._box.value = join(self._bins.boxes[at], self._box.value)
        self._count.value = self._count.value + self._bins.counts[at]
        return area(self._box.value) * leaves(self._count.value, leaf_bits)


def leaves(count: Value, leaf_bits: Value) -> Value:
    """An estimate of the number of leaves for some primitives, of which 2^leaf_bits fit into one."""
    full = count.function.constant(I32, 1) << leaf_bits
    least = ((count + full - 1) >> leaf_bits).to(F32)
    return least * ROUNDING + count.to(F32) * ((1 - ROUNDING) / full.to(F32))


@dataclass
class Split:
    """The best split of a node so far: behind which slab of which axis."""

    cost: Variable
    axis: Variable
    slab: Variable

    @staticmethod
    def best(f: Function, grid: Grid, bins: Bins, leaf_bits: Value) -> Split:
        """The best of all splits; the cost stays infinite if all primitives are in one slab."""
        split = Split(f.variable(F32, float("inf")), f.variable(I64, 0), f.variable(I64, 0))
        right_costs = f.array(F32, 3 * BINS)
        from_right = [Sweep(f, bins, axis) for axis in range(3)]
        with f.each(1, grid.count) as i:
            slab = grid.count - i
            for axis, sweep in enumerate(from_right):
                right_costs[slab + axis * BINS] = sweep.cost(slab, leaf_bits)
        from_left = [Sweep(f, bins, axis) for axis in range(3)]
        with f.each(0, grid.count - 1) as slab:
            for axis, sweep in enumerate(from_left):
                cost = sweep.cost(slab, leaf_bits) + right_costs[slab + (axis * BINS + 1)]
                better = cost < split.cost.value
                split.cost.value = select(better, cost, split.cost.value)
                split.axis.value = select(better, f.constant(I64, axis), split.axis.value)
                split.slab.value = select(better, slab, split.slab.value)
        return split


def add_part(module: Module) -> None:
    """Split a node, unless it should be a leaf; tell whether it was split.

    The children become the nodes `pair` and `pair` + 1.
    """
    with module.function("part", [*STATE, ("index", I64), ("pair", I64)], I64, internal=True) as f:
        nodes, even, odd, sorted, deepest, index, pair = f.parameters
        node = Node(f, nodes, index)
        first, count, level = node.first, node.count, node.level
        end = first + count
        is_odd = (level & 1) == 1
        source, target = select(is_odd, odd, even), select(is_odd, even, odd)

        with f.when(count == 1):
            finish_leaf(f, node, source, sorted)
            f.give(0)
        with f.when(count <= LEAF_SIZE), f.when(is_full(f, node, source)):
            finish_leaf(f, node, source, sorted)
            f.give(0)
        bins_count = select(count <= FEW, f.constant(I64, FEW_BINS), BINS)
        grid = Grid.of(*node.centroids, bins_count)
        bins = Bins.filled(f, grid, source, first, end)
        box = node.box
        # Word 7 of the box is the count by now, but one of its bins knows.
        mixed = holds_placed(f, bins, grid)
        split = Split.best(f, grid, bins, select(mixed, f.constant(I32, 0), LEAF_SIZE.bit_length() - 1))

        fits = (count <= LEAF_SIZE) & ~mixed
        with f.when(fits & ~(split.cost.value < area(box) * (1 - DIVIDE))):
            finish_leaf(f, node, source, sorted)
            f.give(0)

        # Halves by number, where centroids are equal, or so skewed that the tree would become too deep.
        halved = (split.cost.value == float("inf")) | (bit_length(count - 1) + level >= deepest)
        move(f, node, Node(f, nodes, pair), Node(f, nodes, pair + 1), source, target, grid, split, halved)
        node.first, node.count = pair, INNER
        f.give(1)


def is_full(f: Function, node: Node, source: Value) -> Value:
    """Whether the boxes of some triangles fill that of their node: a split would gain nothing."""
    first, sum = node.first, f.variable(F32, 0.0)
    with f.each(first, first + node.count) as i:
        box = f.load(BOX, source.at(i * PRIMITIVE_SIZE))
        sum.value = sum.value + select(box.lane(7) == ALONE, f.constant(F32, -float("inf")), area(box))
    return sum.value > area(node.box) * FULL


def holds_placed(f: Function, bins: Bins, grid: Grid) -> Value:
    """Whether any primitive in the bins needs a leaf for itself."""
    box = f.variable(BOX, EMPTY)
    with f.each(0, grid.count) as slab:
        box.value = join(box.value, bins.boxes[slab])
    return box.value.lane(7) == ALONE


def finish_leaf(f: Function, node: Node, source: Value, sorted: Value) -> None:
    """Make a node a leaf, and note its primitives."""
    first, count = node.first, node.count
    with f.each(first, first + count) as i:
        record = source.at(i * PRIMITIVE_SIZE)
        number = f.load(I32, record.at(12)) - BIAS
        f.store(number, sorted.at(i * 4))
        with f.when(f.load(F32, record.at(28)) == ALONE):
            node.first, node.count = number.to(I64), PLACED_COUNT


def move(
    f: Function,
    node: Node,
    left: Node,
    right: Node,
    source: Value,
    target: Value,
    grid: Grid,
    split: Split,
    halved: Value,
) -> None:
    """Move a node's primitives to the other buffer, those of the left child to the front."""
    first, count, level = node.first, node.count, node.level
    end, axis = first + count, split.axis.value
    limit = select(halved, (count >> 1).to(F32), (split.slab.value + 1).to(F32))
    origin, inverse = f.array(F32, 4), f.array(F32, 4)
    origin.store(grid.origin)
    inverse.store(grid.inverse)
    origin_there, inverse_there = origin[axis], inverse[axis]
    bounds = [Bounds.empty(f), Bounds.empty(f)]
    front, back = f.variable(I64, first), f.variable(I64, end)
    with f.each(first, end) as i:
        record = source.at(i * PRIMITIVE_SIZE)
        box = f.load(BOX, record)
        along = record.at(axis * 4)
        centroid = f.load(F32, along) - f.load(F32, along.at(16))
        # The same operations as in `Grid.slabs`, so that both agree to the last bit.
        place = select(halved, (i - first).to(F32), (centroid - origin_there) * inverse_there)
        step = (place < limit).to(I64)
        to = select(place < limit, front.value, back.value - 1)
        f.store(box, target.at(to * PRIMITIVE_SIZE))
        front.value = front.value + step
        back.value = back.value - (1 - step)
        # Which way a primitive goes is hard to foresee. A comparison in all lanes doesn't become a jump.
        goes_left = place.spread(8) < limit
        bounds[0].add(box, goes_left)
        bounds[1].add(box, ~goes_left)
    middle = front.value
    for child, own, begin, size in ((left, bounds[0], first, middle - first), (right, bounds[1], middle, end - middle)):
        child.set_bounds(own.box.value, own.low.value, own.high.value)
        child.first, child.count, child.level = begin, size, level + 1


# ---- trees --------------------------------------------------------------------------------------------


def add_split(module: Module) -> None:
    """Split one node; tell whether it was split. See `add_part`."""
    with module.function("split", [*STATE, ("index", I64), ("pair", I64)], I64) as f:
        was_split = f.call("part", f.parameters, I64)
        assert was_split is not None
        f.give(was_split)


def add_grow(module: Module) -> None:
    """Split a node, its children and so on up to the leaves; return the end of the new nodes.

    They are stored from the node `pair` on, every child after its parent.
    """
    with module.function("grow", [*STATE, ("index", I64), ("pair", I64)], I64) as f:
        *state, index, pair = f.parameters
        waiting, height = f.array(I64, STACK), f.variable(I64, 0)
        current, free = f.variable(I64, index), f.variable(I64, pair)
        with f.loop() as turns:
            was_split = f.call("part", [*state, current.value, free.value], I64)
            assert was_split is not None
            with f.either(was_split == 1) as branch:
                waiting[height.value] = free.value + 1
                height.value = height.value + 1
                current.value = free.value
                free.value = free.value + 2
                branch.otherwise()
                turns.stop_if(height.value == 0)
                height.value = height.value - 1
                current.value = waiting[height.value]
        f.give(free.value)
