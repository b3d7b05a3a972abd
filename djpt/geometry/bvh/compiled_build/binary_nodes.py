"""The records of a tree's construction: primitives, and the nodes of the binary tree that is built first.

Both begin with a box of eight floats: low x, y, z, a word, **minus** high x, y, z, a word. One minimum of
eight lanes then joins two boxes, and low - (-high) is twice the centroid.

Integers between the floats are kept as the bits of ordinary floats, see `stored`.
"""

from __future__ import annotations

from djpt.jit.llvm.arithmetic import minimum
from djpt.jit.llvm.ir import F32, I32, I64, Function, Operand, Value, vector

__all__ = [
    "ALONE",
    "BIAS",
    "BOX",
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
