"""The memory of a tree: leaves and boxes, as functions in LLVM's language.

`emit` writes what stays when triangles move, `fit` writes the rest: corners and boxes, from the leaves up. For the
memory see `djpt.geometry.bvh.calls.layout`.
"""

from __future__ import annotations

from collections.abc import Callable

from djpt.geometry.bvh.build.build_functions import BOX, CORNERS_SIZE, EMPTY
from djpt.geometry.bvh.calls.layout import CHILDREN, LEAF, LEAF_ROWS, NODE_ROWS, PLACED, ROOT, ROW_BYTES
from djpt.jit.llvm.arithmetic import gather, maximum, minimum, select
from djpt.jit.llvm.ir import F32, F64, I32, I64, PTR, Function, Module, Value, vector

__all__ = ["add_fit_functions"]

WORDS, LONGS = vector(I32, CHILDREN), vector(I64, CHILDREN)

REFERENCES, UNUSED, RECORDS = 6 * ROW_BYTES, 7 * ROW_BYTES, 9 * ROW_BYTES
"""The rows of a node and of a leaf that aren't planes or coordinates."""


def add_fit_functions(module: Module) -> None:
    """Add `emit` and `fit` to a module."""
    add_emit(module)
    add_fit_node(module)
    add_fit(module)


# ---- what stays -----------------------------------------------------------------------------------------


def add_emit(module: Module) -> None:
    """Write the references of some nodes, and the records and the order of the triangles in their leaves."""
    parameters = [
        ("references", PTR),
        ("from_", PTR),
        ("to", PTR),
        ("sorted", PTR),
        ("memory", PTR),
        ("order", PTR),
        ("nodes", I64),
        ("first", I64),
        ("end", I64),
    ]
    with module.function("emit", parameters) as f:
        references, from_, to, sorted, memory, order, nodes, first, end = f.parameters
        leaves = nodes * NODE_ROWS + ROOT
        with f.each(first, end) as i:
            node = memory.at((i * NODE_ROWS + ROOT) * ROW_BYTES)
            f.store(f.constant(WORDS, 0), node.at(UNUSED))
            with f.each(0, CHILDREN) as slot:
                reference = f.load(I32, references.at((i * CHILDREN + slot) * 4))
                place = node.at(slot * 4 + REFERENCES)
                f.store(reference, place)
                with f.when((reference >= LEAF) & (reference < PLACED)):
                    leaf = (reference ^ LEAF).to(I64)
                    unit = leaves + leaf * LEAF_ROWS
                    f.store((unit + LEAF).to(I32), place)
                    start = f.load(I32, to.at(leaf * 4))
                    count = f.load(I32, to.at(leaf * 4 + 4)) - start
                    lanes = f.constants(I32, range(CHILDREN))
                    records = start.spread(CHILDREN) + select(lanes < count, lanes, 0)
                    f.store(records, memory.at(unit * ROW_BYTES + RECORDS))
                    source = f.load(I32, from_.at(leaf * 4)).to(I64)
                    with f.each(0, count.to(I64)) as k:
                        triangle = f.load(I32, sorted.at((source + k) * 4))
                        f.store(triangle, order.at((start.to(I64) + k) * 4))


# ---- what moves -----------------------------------------------------------------------------------------

PLACE = [("memory", PTR), ("corners", PTR), ("order", PTR), ("placed", PTR), ("numbers", PTR)]
"""The parameters that the functions share. `numbers`: the centre x, y, z, the slack of boxes, 1 / the diagonal."""


class Planes:
    """The planes of a node's children, row by row."""

    def __init__(self, f: Function) -> None:
        """Put empty boxes into all slots."""
        self.rows = [f.array(F32, CHILDREN) for _ in range(6)]
        for row, array in enumerate(self.rows):
            array.store(f.constant(BOX, -EMPTY if row % 2 else EMPTY))

    def set(self, slot: Value, axis: int, low: Value, high: Value) -> None:
        """Write the planes of a child along one axis."""
        self.rows[2 * axis][slot], self.rows[2 * axis + 1][slot] = low, high


def folded(x: Value, combine: Callable[[Value, Value], Value]) -> Value:
    """Combine all lanes."""
    for step in (4, 2, 1):
        x = combine(x, x.shuffled([(lane + step) % CHILDREN for lane in range(CHILDREN)]))
    return x.lane(0)


def fit_leaf(f: Function, leaf: Value, corners: Value, order: Value, center: list[Value]) -> list[tuple[Value, Value]]:
    """Write the corners of a leaf's triangles, and return their lowest and highest coordinates, axis by axis."""
    records = f.load(WORDS, leaf.at(RECORDS))
    lanes = f.constants(I32, range(CHILDREN))
    there = records == records.lane(0).spread(CHILDREN) + lanes
    triangles = gather(order.at(records.to(LONGS) * 4), there, f.constant(WORDS, 0))
    offsets = triangles.to(LONGS) * CORNERS_SIZE
    missing = f.constant(BOX, float("nan"))
    result = []
    for axis in range(3):
        low, high = f.constant(BOX, EMPTY), f.constant(BOX, -EMPTY)
        for corner in range(3):
            row = 3 * corner + axis
            x = gather(corners.at(offsets + 4 * row), there, missing) - center[axis]
            f.store(x, leaf.at(row * ROW_BYTES))
            # In this order the bounds stay where there is no triangle.
            low, high = minimum(x, low), maximum(x, high)
        result.append((folded(low, minimum), folded(high, maximum)))
    return result


def add_fit_node(module: Module) -> None:
    """Write the leaves and the planes of one node, whose inner children must have theirs.

    Adds the areas of the children that are nodes, and of the others, to two sums.
    """
    with module.function("fit_node", [*PLACE, ("index", I64), ("sums", PTR)], internal=True) as f:
        memory, corners, order, placed, numbers, index, sums = f.parameters
        node = memory.at((index * NODE_ROWS + ROOT) * ROW_BYTES)
        center = [f.load(F32, numbers.at(4 * axis)) for axis in range(3)]
        slack, scale = f.load(F32, numbers.at(12)), f.load(F32, numbers.at(16))
        planes = Planes(f)
        with f.each(0, CHILDREN) as slot:
            reference = f.load(I32, node.at(slot * 4 + REFERENCES))
            with f.either(reference < LEAF) as branch:
                with f.when(reference != 0):
                    child = memory.at(reference.to(I64) * ROW_BYTES)
                    for axis in range(3):
                        low = folded(f.load(BOX, child.at(2 * axis * ROW_BYTES)), minimum)
                        high = folded(f.load(BOX, child.at((2 * axis + 1) * ROW_BYTES)), maximum)
                        planes.set(slot, axis, low, high)
                branch.otherwise()
                with f.either(reference < PLACED) as kind:
                    leaf = memory.at((reference ^ LEAF).to(I64) * ROW_BYTES)
                    for axis, (low, high) in enumerate(fit_leaf(f, leaf, corners, order, center)):
                        planes.set(slot, axis, low - slack, high + slack)
                    kind.otherwise()
                    box = placed.at((reference ^ PLACED).to(I64) * 24)
                    for axis in range(3):
                        low, high = (f.load(F32, box.at(4 * (axis + side))) - center[axis] for side in (0, 3))
                        planes.set(slot, axis, low - slack, high + slack)
        rows = [f.load(BOX, row.address) for row in planes.rows]
        for number, row in enumerate(rows):
            f.store(row, node.at(number * ROW_BYTES))
        references = f.load(WORDS, node.at(REFERENCES))
        x, y, z = ((rows[2 * axis + 1] - rows[2 * axis]) * scale for axis in range(3))
        areas = x * y + y * z + z * x
        is_node, is_leaf = (references < LEAF) & (references != 0), references >= LEAF
        for which, offset in ((is_node, 0), (is_leaf, 8)):
            total = folded(select(which, areas, 0.0), lambda a, b: a + b).to(F64)
            f.store(f.load(F64, sums.at(offset)) + total, sums.at(offset))


def add_fit(module: Module) -> None:
    """Fit a range of nodes, from the last to the first, except those with nodes below them beyond `limit`."""
    parameters = [*PLACE, ("ends", PTR), ("first", I64), ("end", I64), ("limit", I64), ("sums", PTR)]
    with module.function("fit", parameters) as f:
        *place, ends, first, end, limit, sums = f.parameters
        with f.each_backwards(first, end) as index, f.when(f.load(I32, ends.at(index * 4)).to(I64) <= limit):
            f.call("fit_node", [*place, index, sums])
