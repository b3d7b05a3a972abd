"""Looking up one of a few uniform values by a per-lane index.

A kernel that reads scene values from memory at every path vertex is slower than one that
keeps them in registers and selects (docs/performance.md, "no memory traffic in the
loop"). So small tables become a chain of selects over opaque uniform values, and only
larger ones a gather.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any, TypeVar

import drjit as dr

from djpt.types import Bool, Float, UInt32

__all__ = ["MAX_CHAIN", "Flat", "choose", "is_one_of", "opaque"]

MAX_CHAIN = 16
"""Longest select chain; beyond it a table is gathered."""

T = TypeVar("T")


def opaque(value: T) -> T:
    """A detached copy of the Dr.Jit array `value` that kernels take as an input, not as a literal."""
    copy = type(value)(dr.detach(value))  # type: ignore[call-arg]
    dr.make_opaque(copy)
    return copy


def is_one_of(index: UInt32, members: Sequence[int]) -> Bool:
    """True where `index` is in `members`; runs of consecutive members cost one range test."""
    result = Bool(False)
    ordered = sorted(set(members))
    start = 0
    for i in range(len(ordered)):
        if i + 1 < len(ordered) and ordered[i + 1] == ordered[i] + 1:
            continue
        low, high = ordered[start], ordered[i]
        if low == high:
            result |= index == low
        elif low == 0:
            result |= index <= high
        else:
            # One unsigned comparison: values below `low` wrap around to large ones.
            result |= (index - low) <= (high - low)
        start = i + 1
    return result


def choose(index: UInt32, rows: Sequence[Any], identity: Sequence[Hashable] | None = None) -> Any:
    """``rows[index]`` per lane: a chain of selects, or a gather if the rows are many.

    `rows` are width-1 Dr.Jit arrays of one type (or PyTrees of them), `identity` says which of
    them are the same (default: by object). The row that most indices share is the chain's
    default. Indices beyond the table give an unspecified row.
    """
    if identity is None:
        identity = [id(row) for row in rows]
    members: dict[Hashable, list[int]] = {}
    for i, key in enumerate(identity):
        members.setdefault(key, []).append(i)
    groups = sorted(members.values(), key=len, reverse=True)
    if len(groups) > MAX_CHAIN:
        return Flat(rows).gather(index)
    result = rows[groups[0][0]]
    for group in groups[1:]:
        result = dr.select(is_one_of(index, group), rows[group[0]], result)
    return result


class Flat:
    """Rows of equal type packed into one array, for lookups by gather.

    Gradients flow from a gather to the rows, so this form also serves plain automatic
    differentiation through loops, where width-1 values can't be used directly.
    """

    def __init__(self, rows: Sequence[Any]) -> None:
        self.dtype = type(rows[0])
        self.size = len(rows)
        components: list[Any] = [c for row in rows for c in (row if dr.depth_v(row) > 1 else (row,))]
        # An own, aligned buffer: gathers from literals or shared memory don't become packet loads.
        self.data: Any = dr.concat(components)
        dr.make_opaque(self.data)

    def gather(self, index: UInt32, active: Bool | bool = True) -> Any:
        """The rows at `index`; zero where inactive."""
        return dr.gather(self.dtype, self.data, index, active)


def as_float(value: float) -> Float:
    """An opaque width-1 `Float`."""
    return dr.opaque(Float, float(value))
