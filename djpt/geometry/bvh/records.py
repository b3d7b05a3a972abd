"""The BVH in memory: one record of 64 bytes per node or triangle.

A lane that takes a step loads one record, whatever it is, with two packet loads. The children of a
node lie side by side, so that a node holds one reference.

==========  ==================================================  ===================
word        node                                                triangle
==========  ==================================================  ===================
0 .. 8      planes of child c along axis a, at 3 c + a:         corners, 3 x 3 floats
9 .. 11     low in the lower half, high in the upper            unit normal
12          bits 23 .. 30: those of the size of a cell as a     LEAF + mesh
            float; below them: record of the first child
13          origin of the node's frame, 3 floats                face
14, 15                                                          direction of dp/du
==========  ==================================================  ===================

Planes are counted in cells of the node's own frame, 2^16 to its longest side, so that a small object
in a large scene loses nothing. All coordinates count from the middle of the scene, so that far from
the world's origin nothing is lost either. Record 0 is a node without children: lanes that wait spin
on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError
from djpt.lookup import as_float, as_vector
from djpt.types import Float, Point3f, UInt32

if TYPE_CHECKING:
    from djpt.geometry.bvh.wide import WideTree

__all__ = [
    "CELL",
    "CHILD",
    "EMPTY",
    "LEAF",
    "MAX_RECORDS",
    "MESH",
    "ROOT",
    "WORDS",
    "Records",
    "TriangleData",
    "aligned",
    "pack",
]

WORDS = 16
CHILD, CELL = 0x007FFFFF, 0x7F800000
"""The parts of word 12 of nodes."""

EMPTY = 0
ROOT = 1
LEAF = 0x80000000
"""Set in word 12 of triangles."""

MESH = 0x7FFFFFFF
"""The rest of word 12 of triangles."""

MAX_RECORDS = 1 << 23
"""Stack entries hold a record number and three 3-bit tags in 32 bits."""

NO_CHILD = 0x0000FFFF
"""Planes in reverse order: no ray passes between them."""

EMPTY_CELL = (127 + 20) << 23
"""A large cell, so that no rounding puts the reversed planes in order again."""

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
    center: Point3f
    """The middle of all triangles: the origin of the records' coordinates."""
    radius: Float
    """No triangle reaches further from the centre."""
    extent: float
    """The diagonal of the triangles' bounding box."""
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


@dataclass
class TriangleData:
    """What the records of triangles hold; (F, ..) arrays."""

    corners: NDArray[np.float32]
    """(F, 3, 3)."""
    mesh: NDArray[np.uint32]
    normal: NDArray[np.float32]
    """(F, 3)."""
    direction: NDArray[np.float32]
    """(F, 2), see `djpt.geometry.face_frames`."""


def pack(tree: WideTree, triangles: TriangleData) -> Records:
    """Lay out a tree over triangles."""
    corners = triangles.corners
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
    words[EMPTY, :12], words[EMPTY, 12] = NO_CHILD, EMPTY_CELL
    low, high = tree.box[0, filled[0], :3].min(axis=0), tree.box[0, filled[0], 3:].max(axis=0)
    center = ((low.astype(np.float64) + high) / 2).astype(np.float32)
    extent = float(np.linalg.norm(high.astype(np.float64) - low))
    fill_nodes(words, record_of_node, tree, filled, first_child, center, np.float32(SLACK * max(extent, 1e-30)))
    fill_triangles(words, slots[leaf], face, triangles, center)
    return Records(
        aligned(words),
        count,
        tree.depth,
        as_vector(center.astype(np.float64)),
        as_float(0.50001 * extent),
        extent,
        record_of_face,
    )


CHUNK = 1 << 16
"""Nodes that are quantised at a time: bounds temporary memory."""


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
        # A power of two, so that counting cells rounds nothing; with room for the margins below.
        longest = np.maximum((high.max(axis=1) - lowest).max(axis=1), np.float32(1e-30))
        exponent = np.clip(np.ceil(np.log2(longest * np.float32(1 / 65000))), -100, 100).astype(np.int32)
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


def fill_triangles(
    words: NDArray[np.uint32],
    record: NDArray[np.uint32],
    face: NDArray[np.int32],
    triangles: TriangleData,
    center: NDArray[np.float32],
) -> None:
    """Write the triangles' records."""
    for begin in range(0, len(record), 4 * CHUNK):
        part = slice(begin, begin + 4 * CHUNK)
        at, of = record[part], face[part]
        words[at, :9] = (triangles.corners[of] - center).reshape(-1, 9).view(np.uint32)
        words[at, 9:12] = triangles.normal[of].view(np.uint32)
        words[at, 12] = triangles.mesh[of] | np.uint32(LEAF)
        words[at, 13] = of
        words[at, 14:] = triangles.direction[of].view(np.uint32)
