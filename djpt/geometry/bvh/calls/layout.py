"""The memory that compiled ray queries read: one block, counted in rows of 32 bytes.

==============  ====  ==========================================================================
part            rows  contents
==============  ====  ==========================================================================
header          8     word 0: row of the first triangle's record; word 1: of the first placed record;
                      words 2, 3: the tree's radius, and the usual size of its triangles, as floats;
                      words 4 to 6: row of its faces' tables, number of their corners and of faces
node            8     2 a: low planes of the eight children along axis a; 2 a + 1: high planes;
                      6: references to the children; 7: unused
leaf            10    3 k + a: coordinate a of corner k of eight triangles; 9: their numbers
placed          2     map into the primitive's space, 3 x 4 floats; label, detail, side, unused
triangle        1     way through, unit normal, label, face, direction of dp/du
faces                 if they are few: see `djpt.geometry.bvh.calls.faces`
==============  ====  ==========================================================================

A reference is the row of a node; with LEAF, the row of a leaf; with PLACED, the number of a placed primitive
(an instance, or an analytic solid). Triangles are numbered in the order of the leaves. The record of a triangle or
placed primitive is the row that holds its label; for labels and details see `djpt.geometry.bvh.steps.records`.

A group of meshes that instances show has a block of its own, with a header, within the block of the scene. References
in it count from its start, records from the start of the scene's.

The *way through* a triangle is 0 if it is opaque. Else it has the bit PASSABLE, and if it bounds media the bit BOUNDS,
the number of the medium inside in bits 8 .. 15, and that of the medium outside in bits 0 .. 7.

Coordinates count from the middle of their tree.
"""

from __future__ import annotations

__all__ = [
    "ANY_HIT",
    "BOUNDS",
    "CHILDREN",
    "CHILD_ROW",
    "EXTENT_WORD",
    "FACES_WORD",
    "HEADER_ROWS",
    "LEAF",
    "LEAF_ROWS",
    "MEDIA",
    "MEDIUM_BITS",
    "NODE_ROWS",
    "NUMBER_ROW",
    "PASSABLE",
    "PASSES_LIGHTS",
    "PLACED",
    "REFERENCE",
    "ROOT",
    "ROW_BYTES",
    "ROW_WORDS",
]

ROW_WORDS, ROW_BYTES = 8, 32
HEADER_ROWS, NODE_ROWS, LEAF_ROWS = 8, 8, 10
EXTENT_WORD = 2
"""The word of the header that holds the radius, before the size of triangles."""

FACES_WORD = 4
"""The word of the header that says where the faces begin, before their number and margin."""

CHILDREN = 8
"""The children of a node, and the triangles of a leaf."""

CHILD_ROW, NUMBER_ROW = 6 * ROW_BYTES, 9 * ROW_BYTES
"""The bytes from the start of a node to its references, and from that of a leaf to the numbers of its triangles."""

LEAF, PLACED, REFERENCE = 0x80000000, 0xC0000000, 0x3FFFFFFF
"""The upper bits of references to leaves and to placed primitives; the bits of the row number."""

ROOT = HEADER_ROWS
"""The row of the root."""

PASSES_LIGHTS, ANY_HIT = 1, 2
"""Bits of a ray's flags: shapes that emit aren't hit; any hit ends the search, also one for the closest."""

PASSABLE, BOUNDS = 0x80000000, 0x40000000
"""Bits of the way through a triangle."""

MEDIUM_BITS = 8
"""The bits of a medium's number there; a search that measures media begins with the one above these bits of the flags.
"""

MEDIA = 4
"""The most media that such a search tells apart, for a call has room for as many results. They count from 1; 0 is the
vacuum."""
