"""The memory that compiled ray queries read: one block, counted in rows of 32 bytes.

==============  ====  ==========================================================================
part            rows  contents
==============  ====  ==========================================================================
header          8     word 0: 1 if there are placed primitives
node            8     2 a: low planes of the eight children along axis a; 2 a + 1: high planes;
                      6: references to the children; 7: unused
leaf            10    3 k + a: coordinate a of corner k of eight triangles; 9: their records
placed          2     map into the primitive's space, 3 x 4 floats; label, detail, side, unused
triangle        1     unused, unit normal, label, face, direction of dp/du
==============  ====  ==========================================================================

A reference is a row number: of a node; with LEAF, of a leaf; with PLACED, of the *second* row of a placed primitive
(an instance, or an analytic solid). The record of a triangle or placed primitive is the number of the row
that holds its label, at word 4; for labels and details see `djpt.geometry.bvh.records`.

A group of meshes that instances show has a block of its own within the block of the scene. References inside it count
from its start, records from the start of the scene's.

Coordinates count from the middle of their tree.
"""

from __future__ import annotations

__all__ = [
    "CHILDREN",
    "DETAIL_WORD",
    "HEADER_ROWS",
    "LABEL_WORD",
    "LEAF",
    "LEAF_ROWS",
    "NODE_ROWS",
    "PLACED",
    "REFERENCE",
    "ROOT",
    "ROW_BYTES",
    "ROW_WORDS",
]

ROW_WORDS, ROW_BYTES = 8, 32
HEADER_ROWS, NODE_ROWS, LEAF_ROWS = 8, 8, 10
CHILDREN = 8
"""The children of a node, and the triangles of a leaf."""

LEAF, PLACED, REFERENCE = 0x80000000, 0xC0000000, 0x3FFFFFFF
"""The upper bits of references to leaves and to placed primitives; the bits of the row number."""

ROOT = HEADER_ROWS
"""The row of the root."""

LABEL_WORD, DETAIL_WORD = 4, 5
"""Words of a record's row: the label; the face, or what a placed primitive is."""
