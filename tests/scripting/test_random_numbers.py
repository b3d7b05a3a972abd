"""Hashes, permutations and radical inverses: the same numbers as Mitsuba's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import ArgumentError
from tests.kit.same_calls import same

CALLS: list[Callable[[Any], Any]] = [
    *(
        lambda m, f=f, a=a: getattr(m, f)(*a)
        for f in ("sample_tea_32", "sample_tea_64", "sample_tea_float32", "sample_tea_float64", "sample_tea_float")
        for a in ((1, 2), (3, 4, 7), ([1, 2, 3], 5), ([1, 2, 3], [5, 6, 7], 2))
    ),
    *(lambda m, n=n: m.permute(list(range(n)), n, 7) for n in (1, 2, 16)),
    lambda m: m.permute(3, 8, [1, 2, 3], 2),
    *(lambda m, n=n: m.permute_kensler(list(range(n)), n, 7) for n in (1, 2, 7, 16)),
    lambda m: m.permute_kensler(3, 11, [1, 2, 3]),
    lambda m: m.radical_inverse_2([0, 1, 2, 5, 1000], 0),
    lambda m: m.radical_inverse_2([0, 1, 2, 5], [7, 2**31, 3, 2**32 - 1]),
    lambda m: m.sobol_2([0, 1, 2, 5, 1000], 7),
    *(lambda m, k=k: m.RadicalInverse(30).eval(k, [0, 1, 2, 3, 10, 1000, 123456789]) for k in (0, 1, 5)),
    *(
        lambda m, k=k, s=s: [x.astype(float) for x in [m.RadicalInverse(30, s).permutation(k)]]
        for s in (-1, 0, 3)
        for k in range(8)
    ),
    lambda m: [m.RadicalInverse(30, s).inverse_permutation(k) for s in (-1, 3) for k in (0, 1)],
    lambda m: [m.RadicalInverse(30).bases(), m.RadicalInverse(30).base(5), m.RadicalInverse(30, 3).scramble()],
    lambda m: m.PCG32(size=3, initstate=5).next_float32(),
    lambda m: m.Philox4x32(1, 2, 3).next_uint32x4(),
    lambda m: m.ScalarPCG32(initstate=3).next_float32(),
]


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.sparse(13)
def test_same_numbers(call: Callable[[Any], Any], mi: Any) -> None:
    same(call, mi, rtol=1e-7, atol=0)


def test_hashes_of_integers_are_integers() -> None:
    assert all(isinstance(word, int) for word in djpt.sample_tea_32(1, 2))
    assert isinstance(djpt.sample_tea_64(1, 2), int)
    assert isinstance(djpt.sample_tea_float(1, 2), float)
    assert type(djpt.sample_tea_float64(djpt.UInt32(1), 2)) is djpt.Float64


def test_permutations_are_bijections() -> None:
    for seed in range(20):
        assert sorted(djpt.permute(dr.arange(djpt.UInt32, 32), 32, seed).numpy()) == list(range(32))
        assert sorted(djpt.permute_kensler(dr.arange(djpt.UInt32, 23), 23, seed).numpy()) == list(range(23))


def test_radical_inverses_are_mirrored_digits() -> None:
    digits = np.array([int(np.base_repr(i, 5)[::-1], 5) / 5 ** len(np.base_repr(i, 5)) for i in range(100)])
    np.testing.assert_allclose(djpt.RadicalInverse().eval(2, list(range(100))).numpy(), digits, rtol=1e-6)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: djpt.permute(0, 12, 1), "must be a power of two, found 12"),
        (lambda: djpt.RadicalInverse(1), "must be at least 2, found 1"),
        (lambda: djpt.RadicalInverse(10).eval(4, 1), "base 4 doesn't exist; 'max_base' allows 4"),
    ],
)
def test_what_is_refused(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        call()
