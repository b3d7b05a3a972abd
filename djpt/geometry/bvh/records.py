"""The BVH in memory: one record of 64 bytes per node or triangle.

A lane that takes a step loads one record, whatever it is, with two packet loads. The children of a
node lie side by side, so that a node holds one reference.

==========  ==================================================  ===================
word        node                                                triangle
==========  ==================================================  ===================
0 .. 11     planes of child c along axis a, at 3 c + a:         corners, 3 x 3
            low in the lower half, high in the upper            floats; 9 .. 11: 0
12          record of the first child                           LEAF + mesh
13 .. 15    frame along each axis: origin in the upper 24       face of the scene's
            bits of a float, log2 of the cell in the lower 8    mesh set; 0; 0
==========  ==================================================  ===================

Planes are counted in cells of the node's own frame, 2^16 to an axis, so that a small object in a
large scene loses nothing. Record 0 is a node without children: lanes that wait spin on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError
from djpt.types import UInt32

if TYPE_CHECKING:
    from djpt.geometry.bvh.wide import WideTree

__all__ = ["EMPTY", "LEAF", "MAX_RECORDS", "ROOT", "WORDS", "Records", "aligned", "pack"]

WORDS = 16
EMPTY = 0
ROOT = 1
LEAF = 0x80000000
"""Set in word 12 of triangles."""

MAX_RECORDS = 1 << 23
"""Stack entries hold a record number and three 3-bit tags in 32 bits."""

NO_CHILD = 0x0000FFFF
"""Planes in reverse order: no ray passes between them."""

EMPTY_FRAME = 127 + 20
"""Large cells, so that no rounding puts the reversed planes in order again."""

SLACK = 4e-7
"""Boxes grow by this share of the scene's extent: the rounding of a ray's distances to planes."""


@dataclass
class Records:
    """The packed tree, ready for kernels."""

    words: UInt32
    """All records, 16 words each."""
    count: int
    depth: int
    """Levels of nodes: how many stack entries a traversal needs."""
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    record_of_face: NDArray[np.uint32]
    """The record of each triangle."""


def aligned(values: NDArray[np.uint32]) -> UInt32:
    """A Dr.Jit copy of an array in memory of its own.

    Arrays made from NumPy's share its memory, which isn't aligned: Dr.Jit then silently gathers word
    by word instead of whole records.
    """
    words = UInt32(values.ravel()) ^ dr.opaque(UInt32, 0)
    dr.eval(words)
    dr.sync_thread()
    return words


def pack(tree: WideTree, corners: NDArray[np.float32], mesh_of_face: NDArray[np.uint32]) -> Records:
    """Lay out a tree over triangles (F, 3, 3), each of a numbered mesh."""
    filled = tree.child != -1
    fill = filled.sum(axis=1)
    first_child = (ROOT + 1 + np.cumsum(fill) - fill).astype(np.uint32)
    count = int(ROOT + 1 + fill.sum())
    if count > MAX_RECORDS:
        raise SceneError(
            f"{len(corners)} triangles in one scene are too many: about {MAX_RECORDS * 2 // 3} are possible"
        )
    slots = first_child[:, None] + np.arange(tree.child.shape[1], dtype=np.uint32)

    record_of_node = np.empty(len(tree.child), np.uint32)
    record_of_node[0] = ROOT
    inner = tree.child >= 0
    record_of_node[tree.child[inner]] = slots[inner]
    leaf = tree.child <= -2
    face = -2 - tree.child[leaf]
    record_of_face = np.zeros(len(corners), np.uint32)
    record_of_face[face] = slots[leaf]

    words = np.zeros((count, WORDS), np.uint32)
    words[EMPTY, :12], words[EMPTY, 13:] = NO_CHILD, EMPTY_FRAME
    low, high = tree.box[0, filled[0], :3].min(axis=0), tree.box[0, filled[0], 3:].max(axis=0)
    slack = np.float32(SLACK * max(float(np.linalg.norm((high - low).astype(np.float64))), 1e-30))
    fill_nodes(words, record_of_node, tree, filled, first_child, slack)
    fill_triangles(words, slots[leaf], face, corners, mesh_of_face)
    return Records(aligned(words), count, tree.depth, low - slack, high + slack, record_of_face)


CHUNK = 1 << 16
"""Nodes that are quantised at a time: bounds temporary memory."""


def fill_nodes(
    words: NDArray[np.uint32],
    record_of_node: NDArray[np.uint32],
    tree: WideTree,
    filled: NDArray[np.bool_],
    first_child: NDArray[np.uint32],
    slack: np.float32,
) -> None:
    """Write the nodes' records."""
    for begin in range(0, len(tree.child), CHUNK):
        part = slice(begin, begin + CHUNK)
        present = filled[part, :, None]
        low = np.where(present, tree.box[part, :, :3] - slack, np.inf).astype(np.float32)
        high = np.where(present, tree.box[part, :, 3:] + slack, -np.inf).astype(np.float32)
        origin, cell, frame = frames(low.min(axis=1), high.max(axis=1))
        # Half a cell is lost when a ray's offset is rounded in units of 2^23 cells (see `traversal`).
        scale = 1 / cell[:, None]
        first = np.floor((low - origin[:, None]) * scale - np.float32(0.75))
        last = np.ceil((high - origin[:, None]) * scale + np.float32(0.75))
        first = np.where(present, np.clip(first, 0, 65535), 65535).astype(np.uint32)
        last = np.where(present, np.clip(last, 0, 65535), 0).astype(np.uint32)
        record = record_of_node[part]
        words[record, :12] = (first | (last << np.uint32(16))).reshape(-1, 12)
        words[record, 12] = first_child[part]
        words[record, 13:] = frame


def frames(
    low: NDArray[np.float32], high: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint32]]:
    """Per node and axis: an origin, the size of a cell (a power of two), and both in one word.

    Between the origin and `low` there is room for a few cells, and 2^16 cells reach beyond `high`.
    """
    # Only 16 bits of the origin's significand are kept: what is cut off counts as part of the extent.
    reach = np.maximum(high - low, np.float32(1e-30)) + np.abs(low) * np.float32(2**-14)
    exponent = np.clip(np.ceil(np.log2(reach * np.float32(1 / 60000))), -100, 120).astype(np.int32)
    cell = np.ldexp(np.float32(1), exponent)
    bits = cut_down(low - 4 * cell)
    return bits.view(np.float32), cell, bits | (exponent + 127).astype(np.uint32)


def cut_down(x: NDArray[np.float32]) -> NDArray[np.uint32]:
    """The bits of a float not above `x` whose last 8 bits are zero."""
    bits = x.view(np.uint32) & np.uint32(0xFFFFFF00)
    # Cutting bits off moves a negative number up: take the next one down.
    cut = (x < 0) & (bits.view(np.float32) > x)
    return np.where(cut, bits + np.uint32(0x100), bits)


def fill_triangles(
    words: NDArray[np.uint32],
    record: NDArray[np.uint32],
    face: NDArray[np.int32],
    corners: NDArray[np.float32],
    mesh_of_face: NDArray[np.uint32],
) -> None:
    """Write the triangles' records."""
    for begin in range(0, len(record), 4 * CHUNK):
        part = slice(begin, begin + 4 * CHUNK)
        at, of = record[part], face[part]
        words[at, :9] = corners[of].reshape(-1, 9).view(np.uint32)
        words[at, 12] = mesh_of_face[of] | np.uint32(LEAF)
        words[at, 13] = of
