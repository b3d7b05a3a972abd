"""Vectors with a number for each child of a node: the nearest child, and those of a mask moved together.

The processor must have AVX2.
"""

from __future__ import annotations

from djpt.geometry.bvh.calls.layout import CHILDREN
from djpt.jit.llvm.arithmetic import select
from djpt.jit.llvm.ir import I1, I8, I16, I32, I64, Value, vector

__all__ = ["HALVES", "MASK", "NOWHERE", "WORDS", "compressed", "distance_words", "nearest_child"]

WORDS, HALVES, MASK = vector(I32, CHILDREN), vector(I16, CHILDREN), vector(I1, CHILDREN)
"""Integers of 32 and 16 bits, and conditions, for each child of a node or triangle of a leaf."""

NOWHERE = 0xFFFFFFFF
"""The distance, as bits, of what isn't on the way. A NaN."""

LANES_OF_MASKS = [
    int.from_bytes(bytes(k for k in range(CHILDREN) if mask >> k & 1), "little") for mask in range(1 << CHILDREN)
]
"""For each mask of eight lanes the numbers of those that are set, a byte each."""


def distance_words(distance: Value, met: Value) -> Value:
    """The bits of distances of the children that are met, `NOWHERE` for the others."""
    return select(met, distance.bits_as(WORDS), NOWHERE)


def nearest_child(distances: Value) -> Value:
    """The number of the least of eight `distance_words`, of which 16 bits are compared."""
    # Distances aren't negative, so that their bits are sorted as they are; the sign is left out.
    upper = (distances >> 15).to(HALVES)
    least = upper.function.intrinsic("x86.sse41.phminposuw", [upper], HALVES, suffix="")
    return least.lane(1).to(I32)


def compressed(words: Value, bits: Value) -> Value:
    """The words of the lanes that are set in a mask, one after the other; unspecified behind them."""
    f = words.function
    orders = f.table("lanes_of_masks", I64, LANES_OF_MASKS)
    order = f.load(vector(I8, CHILDREN), orders.at((bits & 0xFF).to(I64) * 8), align=8)
    return f.intrinsic("x86.avx2.permd", [words, order.to(WORDS)], WORDS, suffix="")
