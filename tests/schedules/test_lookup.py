"""Tables and sets of numbers that kernels know."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from djpt.core.lookup import MAX_CHAIN, WORD, Members, Numbers, Rows
from djpt.jit.types import Float, UInt32, Vector3f

SETS: dict[str, set[int]] = {
    "none": set(),
    "first": {0},
    "last": {WORD - 2},
    "range": set(range(3, 9)),
    "several": {1, 2, 5, 7, 8, 9, 30},
    "all": set(range(WORD - 1)),
}


@pytest.mark.parametrize("size", [WORD - 1, WORD, 3 * WORD])
@pytest.mark.parametrize("name", SETS)
def test_members(name: str, size: int) -> None:
    """In sets that fit into a word, and in larger ones."""
    index = dr.arange(UInt32, size)
    members, expected = Members(SETS[name], size), np.isin(np.arange(size), list(SETS[name]))
    np.testing.assert_array_equal(np.array(members.contain(index) | (index > size)), expected)

    value = Vector3f(Float(index) + 1, -0.5, 0)
    turned = members.negated(index, value)
    for a, b in zip(turned, value, strict=True):
        full = np.broadcast_to(np.array(b), size)
        found = np.array(a + dr.zeros(Float, size) if dr.width(a) < size else a)
        np.testing.assert_array_equal(found, np.where(expected, -full, full))


@pytest.mark.parametrize("size", [7, WORD, WORD + 1])
@pytest.mark.parametrize("distinct", [1, 2, 5, MAX_CHAIN + 3])
def test_tables(size: int, distinct: int) -> None:
    """By words, by comparisons and by gathers."""
    values = [(5 * n + n // 3) % distinct for n in range(size)]
    index = dr.arange(UInt32, size)
    found = np.array(Numbers(values).at(index) + dr.zeros(UInt32, size))
    np.testing.assert_array_equal(found, values)
    rows = [dr.opaque(Float, 10 + v) for v in range(distinct)]
    table = Rows([rows[v] for v in values])
    np.testing.assert_array_equal(np.array(table.at(index) + dr.zeros(Float, size)), 10 + np.array(values))
