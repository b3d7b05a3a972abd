"""The BVH in memory: one record of 64 bytes per node, triangle or instance.

A lane that takes a step loads one record, whatever it is, with two packet loads. The children of a
node lie side by side, so that a node holds one reference.

======  ================================================  ======================  ==================
word    node                                              triangle                instance
======  ================================================  ======================  ==================
0 .. 8  planes of child c along axis a, at 3 c + a:       corners, 3 x 3 floats   into the space of
9 .. 11 low in the lower half, high in the upper          unit normal             its group: 3 x 4
12      bits 23 .. 30: those of the size of a cell as a   LEAF + EMITS + mesh     LEAF + PORTAL +
        float; below them: record of the first child                              number of it
13      origin of the node's frame, 3 floats              face                    root of its group
14, 15                                                    direction of dp/du      0, 0
======  ================================================  ======================  ==================

Planes are counted in cells of the node's own frame, 2^16 to its longest side, so that a small object
in a large scene loses nothing. All coordinates count from the middle of their tree, so that far from
the world's origin nothing is lost either. Record 0 is a node without children: lanes that wait spin
on it. Record 1 is the way out of an instance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError
from djpt.geometry.bvh.leaves import Extent
from djpt.jit.kernels import aligned, as_float, as_vector
from djpt.jit.types import Float, Point3f, UInt32

if TYPE_CHECKING:
    from djpt.geometry.bvh.build.wide import WideTree

__all__ = [
    "CELL",
    "CHILD",
    "EMITS",
    "EMPTY",
    "EXIT",
    "LEAF",
    "NUMBER",
    "ONE_SIDED",
    "PORTAL",
    "ROOT",
    "SOLID",
    "WORDS",
    "Leaves",
    "Records",
    "extent_of",
    "pack",
    "roots",
]

WORDS = 16

CHILD, CELL = 0x007FFFFF, 0x7F800000
"""The bits of word 12 of nodes: the record of the first child, and the size of a cell."""

LEAF, PORTAL, EMITS, SOLID = 0x80000000, 0x40000000, 0x20000000, 0x10000000
ONE_SIDED, NUMBER = 0x08000000, 0x07FFFFFF
"""The bits of word 12 of leaves.

PORTAL: an instance, the way out of one, or, with SOLID, an analytic shape. EMITS: it is part of a light.
ONE_SIDED: rays that come from behind pass through the triangle.
"""

EMPTY, EXIT, ROOT = 0, 1, 2
"""Records with a fixed place: the empty node, the way out of an instance, the root."""

MAX_RECORDS = CHILD + 1
"""Most records: an entry of the stack holds a record's number and three 3-bit tags in 32 bits."""

NO_CHILD = 0x0000FFFF
"""The word of a missing child: its planes are in reverse order, so that no ray passes between them."""

EMPTY_CELL = (127 + 20) << 23
"""The cell size of the empty node, so large that no rounding puts its reversed planes in order again."""

CHUNK = 1 << 16
"""Nodes quantised at a time: bounds temporary memory."""


class Leaves(Protocol):
    """The primitives that a tree's leaves refer to."""

    def write(
        self, words: NDArray[np.uint32], at: NDArray[np.uint32], of: NDArray[np.int32], center: NDArray[np.float32]
    ) -> None:
        """Write the records `at` of the primitives `of`; `center` is the origin of coordinates."""


@dataclass
class Records:
    """The packed trees, ready for kernels."""

    words: UInt32
    """The records, 16 words each."""
    count: int
    depth: int
    """Stack entries that a traversal needs."""
    center: Point3f
    """The middle of the first tree's box: the origin of its coordinates."""
    radius: Float
    """The radius of a sphere about `center` that holds everything."""
    extent: float
    """The diagonal of the bounding box."""
    instanced: bool
    """Whether there are instances."""
    kinds: tuple[int, ...]
    """The analytic shapes among the leaves: numbers into `canonical.KINDS`."""
    one_sided: bool = False
    """Whether there are one-sided triangles."""


def extent_of(tree: WideTree) -> Extent:
    """The extent of a tree: the box of the root's children."""
    filled = tree.child[0] != -1
    return Extent(tree.box[0, filled, :3].min(axis=0), tree.box[0, filled, 3:].max(axis=0))


def roots(trees: Sequence[WideTree]) -> list[int]:
    """The record at which `pack` puts the root of each tree."""
    sizes = [1 + int((tree.child != -1).sum()) for tree in trees]
    return [ROOT + int(n) for n in np.cumsum([0, *sizes])]


def pack(
    trees: Sequence[WideTree],
    leaves: Sequence[Leaves],
    least_depth: int = 0,
    kinds: tuple[int, ...] = (),
    one_sided: bool = False,
) -> Records:
    """Lay out some trees, each over the primitives of its `leaves`; rays start in the first.

    Rays reach the others through instances. `least_depth`, the depth before an edit, keeps compiled kernels usable.
    """
    starts = roots(trees)
    if starts[-1] > MAX_RECORDS:
        raise SceneError(
            f"the scene has too many triangles: they take {starts[-1]} records of the BVH; at most {MAX_RECORDS} are "
            "possible"
        )
    words = aligned((starts[-1], WORDS))
    words[EMPTY, :12], words[EMPTY, 12] = NO_CHILD, EMPTY_CELL
    words[EXIT, 12] = LEAF | PORTAL | NUMBER
    extents = [extent_of(tree) for tree in trees]
    for tree, root, primitives, extent in zip(trees, starts, leaves, extents, strict=False):
        pack_tree(words, tree, root, primitives, extent)
    first = extents[0]
    return Records(
        UInt32(words.ravel()),
        starts[-1],
        max(least_depth, trees[0].depth + max((1 + tree.depth for tree in trees[1:]), default=0)),
        as_vector(first.center.astype(np.float64)),
        as_float(0.50001 * first.diagonal),
        first.diagonal,
        len(trees) > 1,
        kinds,
        one_sided,
    )


def pack_tree(words: NDArray[np.uint32], tree: WideTree, root: int, leaves: Leaves, extent: Extent) -> None:
    """Write the records of one tree."""
    filled = tree.child != -1
    fill = filled.sum(axis=1)
    first_child = (root + 1 + np.cumsum(fill) - fill).astype(np.uint32)
    slots = first_child[:, None] + np.arange(tree.child.shape[1], dtype=np.uint32)
    record_of_node = np.empty(len(tree.child), np.uint32)
    record_of_node[0] = root
    inner = tree.child >= 0
    record_of_node[tree.child[inner]] = slots[inner]
    slack = np.float32(extent.slack)
    fill_nodes(words, record_of_node, tree, filled, first_child, extent.center, slack)
    leaf = tree.child <= -2
    at, of = slots[leaf], -2 - tree.child[leaf]
    for begin in range(0, len(at), 4 * CHUNK):
        part = slice(begin, begin + 4 * CHUNK)
        leaves.write(words, at[part], of[part], extent.center)


def fill_nodes(
    words: NDArray[np.uint32],
    record_of_node: NDArray[np.uint32],
    tree: WideTree,
    filled: NDArray[np.bool_],
    first_child: NDArray[np.uint32],
    center: NDArray[np.float32],
    slack: np.float32,
) -> None:
    """Write the nodes' records."""
    for begin in range(0, len(tree.child), CHUNK):
        part = slice(begin, begin + CHUNK)
        present = filled[part, :, None]
        low = np.where(present, tree.box[part, :, :3] - center - slack, np.inf).astype(np.float32)
        high = np.where(present, tree.box[part, :, 3:] - center + slack, -np.inf).astype(np.float32)
        lowest = low.min(axis=1)
        # A power of two, so that multiples of it are exact; with room for the margins below.
        longest = np.maximum((high.max(axis=1) - lowest).max(axis=1), np.float32(1e-30))
        exponent = np.clip(np.ceil(np.log2(longest * np.float32(1 / 65000))), -100, 60).astype(np.int32)
        cell = np.ldexp(np.float32(1), exponent)[:, None]
        origin = lowest - 4 * cell
        # Half a cell is lost when a ray's offset is rounded in units of 2^23 cells (see `traversal`).
        inverse = 1 / cell[:, None]
        first = np.floor((low - origin[:, None]) * inverse - np.float32(0.75))
        last = np.ceil((high - origin[:, None]) * inverse + np.float32(0.75))
        first = np.where(present, np.clip(first, 0, 65535), 65535).astype(np.uint32)
        last = np.where(present, np.clip(last, 0, 65535), 0).astype(np.uint32)
        record = record_of_node[part]
        words[record, :12] = (first | (last << np.uint32(16))).reshape(-1, 12)
        words[record, 12] = first_child[part] | cell[:, 0].view(np.uint32)
        words[record, 13:] = origin.view(np.uint32)
