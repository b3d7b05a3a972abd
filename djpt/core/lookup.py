"""Looking up one of a few uniform values by a per-lane index.

A kernel that reads scene values from memory at every path vertex is slower than one that
keeps them in registers and selects (docs/performance.md, "no memory traffic in the
loop"). So small tables become a chain of selects over opaque uniform values, and only
larger ones a gather.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.jit.frozen import recording
from djpt.jit.kernels import float_in, one_by_one, opaque, own_copy
from djpt.jit.types import Bool, Int32, UInt32

__all__ = ["MAX_CHAIN", "Flat", "Members", "Numbers", "Rows", "choose", "is_one_of", "runs"]

MAX_CHAIN = 16
"""Longest select chain; beyond it a table is gathered."""

WORD = 32
"""Bits of a word: smaller sets fit into one."""


def runs(members: Iterable[int]) -> list[tuple[int, int]]:
    """The maximal runs (first, last) of consecutive numbers."""
    result: list[tuple[int, int]] = []
    for n in sorted(set(members)):
        if result and result[-1][1] + 1 == n:
            result[-1] = (result[-1][0], n)
        else:
            result.append((n, n))
    return result


def is_one_of(index: UInt32, members: Iterable[int]) -> Bool:
    """True where `index` is in `members`: one range test per run. For few runs; `Members` serves many, too."""
    return is_in_runs(index, runs(members))


def is_in_runs(index: UInt32, ranges: Iterable[tuple[int, int]]) -> Bool:
    """True where `index` is in one of the ranges (first, last)."""
    result = Bool(False)
    for low, high in ranges:
        if low == high:
            result |= index == low
        elif low == 0:
            result |= index <= high
        else:
            # One unsigned comparison: values below `low` wrap around to large ones.
            result |= (index - low) <= (high - low)
    return result


def is_in_table(index: UInt32, ranges: list[tuple[int, int]], size: int) -> Bool:
    """True where `index` is in one of the ranges; numbers that aren't below `size` get any answer."""
    # Of one number at most, one comparison finds it.
    if size > WORD or not ranges or (len(ranges) == 1 and ranges[0][0] == ranges[0][1]):
        return is_in_runs(index, ranges)
    return sign_word(index, ranges) < 0


def sign_word(index: UInt32, ranges: Iterable[tuple[int, int]]) -> Int32:
    """Words that are negative where `index`, below `WORD`, is in one of the ranges: the set's bits, shifted."""
    bits = sum(1 << (WORD - 1 - n) for low, high in ranges for n in range(low, high + 1))
    return Int32(UInt32(bits) << index)


def same_rows(identity: Iterable[Hashable]) -> list[list[int]]:
    """Indices grouped by identity, the largest group first."""
    groups: dict[Hashable, list[int]] = {}
    for i, key in enumerate(identity):
        groups.setdefault(key, []).append(i)
    return sorted(groups.values(), key=len, reverse=True)


def choose(index: UInt32, rows: Sequence[Any], identity: Sequence[Hashable] | None = None) -> Any:
    """The row ``rows[index]`` per lane, by a chain of selects. For few different rows; `Rows` serves many, too.

    `rows` are Dr.Jit arrays of one type, `identity` says which of them are the same (default: by
    object). The row that most indices share is the chain's default. Indices beyond the table
    give an unspecified row.
    """
    return chosen(index, rows, plan([id(row) for row in rows] if identity is None else identity), len(rows))


Plan = list[tuple[int, list[tuple[int, int]]]]
"""Of each group of equal rows one row, and the runs of indices; the default's group first."""


def plan(identity: Sequence[Hashable]) -> Plan:
    """The order of a chain of selects; tables make it once, since kernels are traced for each image."""
    if len(identity) == 1:
        return [(0, [(0, 0)])]
    return [(group[0], runs(group)) for group in same_rows(identity)]


def chosen(index: UInt32, rows: Sequence[Any] | Mapping[int, Any], order: Plan, size: int) -> Any:
    """The row ``rows[index]`` per lane, by a chain of selects in the given order; indices are below `size`."""
    result = rows[order[0][0]]
    for row, ranges in order[1:]:
        result = dr.select(is_in_table(index, ranges, size), rows[row], result)
    return result


class Flat:
    """Rows of equal type packed into one array, for lookups by gather.

    Gradients flow from a gather to the rows, so this form also serves plain automatic
    differentiation through loops, where width-1 values can't be used directly.
    """

    def __init__(self, rows: Sequence[Any]) -> None:
        self.dtype, self._last = type(rows[0]), len(rows) - 1
        components: list[Any] = [c for row in rows for c in (row if dr.depth_v(row) > 1 else (row,))]
        # An own, aligned buffer: gathers from literals or shared memory don't become packet loads.
        if dr.grad_enabled(*components):
            self.data: Any = dr.concat(components)
            dr.make_opaque(self.data)
        else:
            # Not by `dr.concat`: the kernel of a long concatenation takes seconds to compile.
            kind = type(components[0])
            self.data = one_by_one(components) if recording() else opaque(kind([c[0] for c in components]))

    def at(self, index: UInt32) -> Any:
        """The rows at `index`; an unspecified one beyond the last."""
        # The default mode for gradients writes beyond small memory where a row is a packet (Dr.Jit 1.5.0).
        return dr.gather(self.dtype, self.data, inside(index, self._last), mode=dr.ReduceMode.Local)


class Rows:
    """A table of Dr.Jit values, built outside of kernels: a select chain, or a gather if it is long."""

    def __init__(self, rows: Sequence[Any], identity: Sequence[Hashable] | None = None) -> None:
        """Build the table; `rows` and `identity` are as for `choose`."""
        self._rows, self._order = list(rows), plan([id(row) for row in rows] if identity is None else identity)
        self._flat = Flat(rows) if len(self._order) > MAX_CHAIN else None

    def at(self, index: UInt32) -> Any:
        """The row at `index`."""
        return chosen(index, self._rows, self._order, len(self._rows)) if self._flat is None else self._flat.at(index)


class Numbers:
    """A table of whole numbers that are structure: known when kernels are traced."""

    def __init__(self, values: Sequence[int]) -> None:
        self.values = tuple(values)
        self._order = plan(self.values)
        self._long = own_copy(np.array(self.values, np.uint32)) if len(self._order) > MAX_CHAIN else None

    def at(self, index: UInt32) -> UInt32:
        """The number at `index`, an unspecified one beyond the last; 0 if the table is empty."""
        if self._long is not None:
            return dr.gather(UInt32, self._long, inside(index, len(self.values) - 1))
        if not self.values:
            return UInt32(0)
        rows = {row: UInt32(self.values[row]) for row, _ in self._order}
        return chosen(index, rows, self._order, len(self.values))


class Members:
    """A set of indices, known when kernels are traced."""

    def __init__(self, members: Iterable[int], size: int) -> None:
        """Build the set of `members`, some of the numbers 0 .. size - 1."""
        members, self._size = set(members), size + 1
        self._runs = runs(members)
        long = len(self._runs) > MAX_CHAIN
        # One number beyond the last stands for "none of them" (an emitter index may say so).
        self._long = own_copy(np.isin(np.arange(size + 1), list(members)).astype(np.uint32)) if long else None

    def contain(self, index: UInt32) -> Bool:
        """True where `index` is in the set."""
        if self._long is not None:
            return dr.gather(UInt32, self._long, index) != 0
        return is_in_table(index, self._runs, self._size)

    def negated(self, index: UInt32, value: Any) -> Any:
        """The vector -`value` where `index` is in the set, else `value`."""
        if self._size > WORD:
            return dr.select(self.contain(index), -value, value)
        sign = UInt32(sign_word(index, self._runs)) & 0x80000000
        words: list[Any] = [dr.reinterpret_array(UInt32, x) for x in value]
        return type(value)(*(float_in(word ^ sign) for word in words))


def inside(index: UInt32, last: int) -> UInt32:
    """The number `index`, at most `last`: lanes that mean nothing may have any number, but must stay in memory."""
    return dr.select(index < last, index, last)
