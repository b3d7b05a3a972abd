"""The collapse of a binary tree into one with eight children per node, as functions in LLVM's language.

Which binary nodes survive is a small dynamic programme over their surface areas: H. Ylitie, T. Karras and
S. Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", 2017.
"""

from __future__ import annotations

from djpt.geometry.bvh.build.build_functions import (
    BOX,
    COUNT,
    LEAF_SIZE,
    MERGED,
    PLACED_COUNT,
    SMALL,
    Node,
    area,
)
from djpt.geometry.bvh.calls.layout import CHILDREN, LEAF, NODE_ROWS, PLACED, ROOT, ROW_BYTES
from djpt.jit.llvm.arithmetic import maximum, minimum, select
from djpt.jit.llvm.ir import F32, I32, I64, PTR, Array, Function, Module, Value, Variable

__all__ = ["LEAF_COST", "NODE_COST", "add_plan", "add_weigh"]

NODE_COST, LEAF_COST = 1.0, 1.0
"""The times that a ray takes for the boxes of a node and for the triangles of a leaf."""

FAR = float("inf")


def add_weigh(module: Module) -> None:
    """Compute the costs of some binary nodes, from the last to the first, so that children come before parents.

    Cost k of a node is the least for a ray that meets its parent if the node, or what lies below it, takes
    at most k of the slots in a wide node. In one slot, a node of few triangles may be a leaf after all.
    """
    with module.function("weigh", [("nodes", PTR), ("first", I64), ("end", I64), ("scale", F32)]) as f:
        nodes, first, end, scale = f.parameters
        with f.each_backwards(first, end) as index:
            node = Node(f, nodes, index)
            own = scaled_area(node, scale)
            with f.either(node.is_inner) as branch:
                left, right = Node(f, nodes, node.first), Node(f, nodes, node.first + 1)
                shared = shared_out(left.costs, right.costs)
                one = own * NODE_COST + shared.lane(CHILDREN - 1)
                leaf = own * LEAF_COST
                triangles = (left.count & COUNT) + (right.count & COUNT)
                with f.either(triangles <= LEAF_SIZE) as small:
                    node.count = triangles + select(leaf <= one, f.constant(I64, MERGED), SMALL)
                    node.costs = minimum(shared, minimum(leaf, one))
                    small.otherwise()
                    node.costs = minimum(shared, one)
                branch.otherwise()
                node.costs = (own * LEAF_COST).spread(CHILDREN)


def scaled_area(node: Node, scale: Value) -> Value:
    """Half the surface area of a node in units of the root's squared diagonal."""
    return area(node.box) * scale * scale


def shared_out(left: Value, right: Value) -> Value:
    """Lane k: the least cost of two children that share k + 1 slots, at least one each; infinite for one slot."""
    none = left.function.constant(BOX, FAR)
    best = none
    for share in range(1, CHILDREN):
        # Of k + 1 slots the left child gets `share`, the right one the rest, whose cost is in lane k - share.
        rest = none.shuffled([k if k < share else CHILDREN + k - share for k in range(CHILDREN)], right)
        best = minimum(rest + left.lane(share - 1), best)
    return best


def best_share(f: Function, left: Node, right: Node, slots: Value) -> Value:
    """The number of slots of the left child at the least cost."""
    best, share = f.variable(F32, FAR), f.variable(I64, 1)
    with f.each(1, slots) as k:
        cost = left.cost(k) + right.cost(slots - k)
        better = cost < best.value
        best.value, share.value = select(better, cost, best.value), select(better, k, share.value)
    return share.value


class Stack:
    """Rows of integers, of which the last is taken first."""

    def __init__(self, f: Function, size: int, columns: int) -> None:
        self._columns: list[Array] = [f.array(I64, size) for _ in range(columns)]
        self.height: Variable = f.variable(I64, 0)

    def push(self, *row: Value) -> None:
        """Add a row."""
        for column, value in zip(self._columns, row, strict=True):
            column[self.height.value] = value
        self.height.value = self.height.value + 1

    def pop(self) -> list[Value]:
        """Take a row away; there must be one."""
        self.height.value = self.height.value - 1
        return [column[self.height.value] for column in self._columns]


def adopt(f: Function, nodes: Value, root: Value, members: Array) -> Value:
    """Find the binary nodes that become the children of a wide one; return their number."""
    waiting, count = Stack(f, 2 * CHILDREN, 2), f.variable(I64, 0)
    waiting.push(root, f.constant(I64, CHILDREN))
    with f.loop() as turns:
        turns.stop_if(waiting.height.value == 0)
        index, slots = waiting.pop()
        node = Node(f, nodes, index)
        # With fewer slots than all there are costs to compare; the root itself must be opened.
        opens = f.variable(I64, (slots == CHILDREN).to(I64))
        with f.when(slots < CHILDREN):
            opens.value = (node.cost(slots) < node.cost(f.constant(I64, 1))).to(I64)
        with f.either((opens.value == 1) & node.is_inner) as branch:
            left = node.first
            share = best_share(f, Node(f, nodes, left), Node(f, nodes, left + 1), slots)
            waiting.push(left + 1, slots - share)
            waiting.push(left, share)
            branch.otherwise()
            members[count.value] = index
            count.value = count.value + 1
    return count.value


def add_plan(module: Module) -> None:
    """Choose the nodes of the wide tree and number them in depth-first order; return the number of nodes.

    Writes for each node its children's references (from the second row on, and with a leaf's number instead of its
    place) and the end of the nodes below it; for each leaf its first place in the order of the binary leaves and in
    that of the wide tree; and the counts of leaves and of levels.
    """
    parameters = [
        ("nodes", PTR),
        ("root", I64),
        ("references", PTR),
        ("ends", PTR),
        ("from_", PTR),
        ("to", PTR),
        ("counts", PTR),
    ]
    with module.function("plan", parameters, I64) as f:
        nodes, root, references, ends, from_, to, counts = f.parameters
        count, leaf, position, deepest = (f.variable(I64, 0) for _ in range(4))
        members = f.array(I64, CHILDREN)
        # A wide node of each level leaves up to seven others on the stack.
        waiting = Stack(f, 64 * CHILDREN, 3)
        waiting.push(root, f.constant(I64, 0), f.constant(I64, 1))
        with f.loop() as turns:
            turns.stop_if(waiting.height.value == 0)
            index, place, level = waiting.pop()
            own = count.value
            f.store((own * NODE_ROWS + ROOT).to(I32), references.at(place))
            deepest.value = maximum(deepest.value, level)
            row = references.at((own + 1) * ROW_BYTES)
            f.store(f.constant(BOX, 0.0), row)
            children = adopt(f, nodes, index, members)
            with f.each_backwards(0, children) as slot:
                child = Node(f, nodes, members[slot])
                with f.when(child.is_inner & ~child.is_merged):
                    waiting.push(members[slot], (own + 1) * ROW_BYTES + slot * 4, level + 1)
            with f.each(0, children) as slot:
                child = Node(f, nodes, members[slot])
                with f.when(child.count == PLACED_COUNT):
                    f.store((child.first + PLACED).to(I32), row.at(slot * 4))
                with f.when((child.count <= LEAF_SIZE) | child.is_merged):
                    f.store((leaf.value + LEAF).to(I32), row.at(slot * 4))
                    f.store(first_triangle(f, nodes, members[slot]).to(I32), from_.at(leaf.value * 4))
                    f.store(position.value.to(I32), to.at(leaf.value * 4))
                    leaf.value = leaf.value + 1
                    position.value = position.value + (child.count & COUNT)
            count.value = own + 1
        f.store(position.value.to(I32), to.at(leaf.value * 4))
        find_ends(f, references.at(ROW_BYTES), ends, count.value)
        f.store(leaf.value, counts)
        f.store(deepest.value, counts.at(8))
        f.give(count.value)


def first_triangle(f: Function, nodes: Value, index: Value) -> Value:
    """The first triangle below a binary node."""
    at = f.variable(I64, index)
    with f.loop() as turns:
        turns.stop_if(~Node(f, nodes, at.value).is_inner)
        at.value = Node(f, nodes, at.value).first
    return Node(f, nodes, at.value).first


def find_ends(f: Function, references: Value, ends: Value, count: Value) -> None:
    """Write for each node the end of the nodes below it, which follow it without a gap."""
    with f.each_backwards(0, count) as index:
        end = f.variable(I64, index + 1)
        with f.each(0, CHILDREN) as slot:
            reference = f.load(I32, references.at((index * CHILDREN + slot) * 4)).to(I64)
            with f.when((reference != 0) & (reference < LEAF)):
                below = f.load(I32, ends.at(((reference - ROOT) // NODE_ROWS) * 4)).to(I64)
                end.value = maximum(end.value, below)
        f.store(end.value.to(I32), ends.at(index * 4))
