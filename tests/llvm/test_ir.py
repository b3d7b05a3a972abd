"""Code that is built with operators does what NumPy does."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from djpt.errors import DjptError
from djpt.jit.llvm import arithmetic as ar
from djpt.jit.llvm.ir import F32, F64, I1, I8, I32, I64, PTR, Function, Module, Type, Value, vector
from tests.kit.ir import callable_from, evaluate

FLOATS, INTEGERS = ("f4", "f8"), ("u4", "u8")

BOTH = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
WHOLE = {"//": operator.floordiv, "%": operator.mod, "&": operator.and_, "|": operator.or_, "^": operator.xor}


def numbers(dtype: str) -> tuple[Any, Any]:
    """Eight pairs of numbers, with the extremes among them."""
    rng = np.random.default_rng(0)
    if dtype in FLOATS:
        a, b = rng.normal(size=(2, 8)).astype(dtype)
        a[:4], b[:4] = [np.nan, 1.5, np.inf, -0.0], [1, np.nan, -np.inf, 0]
        return a, b
    a, b = rng.integers(0, np.iinfo(dtype).max, (2, 8), dtype, endpoint=True)
    a[:4], b[:4] = [0, np.iinfo(dtype).max, 5, 7], [np.iinfo(dtype).max, 1, 5, 3]
    return a, b


def operations(dtype: str) -> dict[str, Callable[[Any, Any], Any]]:
    return BOTH | ({"/": operator.truediv} if dtype in FLOATS else WHOLE)


@pytest.mark.parametrize("dtype", [*FLOATS, *INTEGERS])
def test_operators_of_vectors_and_scalars(dtype: str) -> None:
    a, b = numbers(dtype)
    chosen = operations(dtype).values()
    b[b == 0] = 1  # for whole quotients

    def compare(build: Callable[..., list[Any]], *arrays: Any) -> None:
        with np.errstate(all="ignore"):
            expected = build(None, *arrays)
        for ours, theirs in zip(evaluate(build, *arrays), expected, strict=True):
            np.testing.assert_array_equal(ours, theirs)

    compare(lambda _, x, y: [f(x, y) for f in chosen], a, b)
    for k in range(8):
        compare(lambda _, x, y: [f(x, y) for f in chosen], a[k], b[k])
    # A scalar beside a vector is copied to all lanes.
    a[a == 0] = 1
    compare(lambda _, x, y: [g for f in chosen for g in (f(x, y), f(y, x))], a, b[3])


@pytest.mark.parametrize("dtype", [*FLOATS, *INTEGERS])
def test_python_numbers_on_either_side(dtype: str) -> None:
    a, _ = numbers(dtype)
    three = np.dtype(dtype).type(3)
    with np.errstate(all="ignore"):
        expected = [a + three, three + a, a - three, three - a, a * three, three * a, a < three, three < a, -a]
    found = evaluate(lambda _, x: [x + 3, 3 + x, x - 3, 3 - x, x * 3, 3 * x, x < 3, x > 3, -x], a)
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_the_other_operators_with_python_numbers() -> None:
    a, _ = numbers("u4")
    seven = np.uint32(7)
    expected = [a & seven, seven & a, a | seven, seven | a, a ^ seven, seven ^ a, ~a, a << np.uint32(5), a >> seven]
    for ours, theirs in zip(
        evaluate(lambda _, x: [x & 7, 7 & x, x | 7, 7 | x, x ^ 7, 7 ^ x, ~x, x << 5, x >> 7], a), expected, strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)
    x = np.float32([1, -2, 0.3, 8])
    np.testing.assert_array_equal(evaluate(lambda _, v: [1.0 / v], x)[0], np.float32(1) / x)


def test_the_sign_of_zero_is_kept() -> None:
    (negated,) = evaluate(lambda _, x: [-x], np.float32([0.0, -0.0]))
    np.testing.assert_array_equal(np.signbit(negated), [True, False])


def test_comparisons_with_nan_are_false_except_not_equal() -> None:
    nan = np.float32(np.nan)
    for other in (nan, np.float32(0)):
        found = evaluate(lambda _, x, y: [x < y, x <= y, x > y, x >= y, x == y, x != y], nan, other)
        assert found == [False] * 5 + [True]


def test_integers_are_unsigned() -> None:
    top = np.uint32(0x80000000)
    found = evaluate(lambda _, x: [x > 1, x >> 4, x // 3, x % 7, x.to(I64), x.to(F64), x == -(2**31)], top)
    assert found == [True, 0x08000000, 0x80000000 // 3, 0x80000000 % 7, 2**31, 2.0**31, True]


def test_addresses_take_integers_of_32_bits_as_unsigned() -> None:
    """Beyond 2^31 an index isn't a negative one."""
    module = Module()
    with module.function("apart", [("base", PTR), ("index", I32)], I64) as f:
        base, index = f.parameters
        words = f.array(I8, 1)
        start = words.place(0)
        by_bytes = f.call("distance", [base, base.at(index)], I64)
        by_elements = f.call("distance", [start, words.place(index)], I64)
        assert by_bytes is not None and by_elements is not None
        f.give(ar.select(by_bytes == by_elements, by_bytes, 0))
    with module.function("distance", [("a", PTR), ("b", PTR)], I64, internal=True) as f:
        a, b = f.parameters
        f.give(f.emit(f"ptrtoint {b} to i64", I64) - f.emit(f"ptrtoint {a} to i64", I64))
    apart = callable_from(module, "apart", "pw", "i")
    assert apart(4096, 3) == 3
    assert apart(4096, 0x80000010) == 0x80000010


# ---- rounding ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("dtype", "bits"), [("f4", 12), ("f8", 27)])
@pytest.mark.parametrize("lanes", [None, 8])
def test_only_fma_is_rounded_once(dtype: str, bits: int, lanes: int | None) -> None:
    """(1 + e)^2 = 1 + 2 e + e^2, whose last term is lost when the product is rounded."""
    e = 2.0**-bits
    a, c = (np.dtype(dtype).type(x) for x in (1 + e, -(1 + 2 * e)))
    if lanes:
        a, c = np.full(lanes, a), np.full(lanes, c)
    once, twice, minus = evaluate(lambda _, x, z: [ar.fma(x, x, z), x * x + z, x * x - x * x], a, c)
    assert (once == e * e).all()
    assert (twice == 0).all() and (minus == 0).all()


def test_fma_mixes_scalars_vectors_and_numbers() -> None:
    x = np.float32([1, 2, 3, 4])
    found = evaluate(lambda _, v, s: [ar.fma(v, s, 1.0), ar.fma(s, 2.0, v), ar.fma(2, v, s)], x, np.float32(10))
    for ours, theirs in zip(found, (10 * x + 1, 20 + x, 2 * x + 10), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_sums_keep_their_order() -> None:
    found = evaluate(lambda _, a, b: [(a + b) - a, a + (b - a)], np.float32(1e8), np.float32(1))
    assert found == [0, np.float32(1e8) + (np.float32(1) - np.float32(1e8))]


def test_constants_are_rounded_to_the_nearest_number() -> None:
    values = [0.1, 1 / 3, 16777217.0, 1e-45, 1e-50, -0.0, float("inf"), float("-inf"), float("nan")]
    for type, dtype in ((F32, np.float32), (F64, np.float64)):
        found = evaluate(lambda f, type=type: [f.constant(type, v) for v in values])
        expected = np.array([dtype(v) for v in values])
        np.testing.assert_array_equal(np.array(found), expected)
        np.testing.assert_array_equal(np.signbit(found), np.signbit(expected))


def test_integer_constants_may_be_negative() -> None:
    numbers = [(I32, -1), (I32, 2**32 - 1), (I64, -1), (I8, 3.0)]
    found = evaluate(lambda f: [f.constant(type, number) for type, number in numbers])
    assert found == [2**32 - 1, 2**32 - 1, 2**64 - 1, 3]
    (row,) = evaluate(lambda f: [f.constant(vector(I32, 4), -2)])
    np.testing.assert_array_equal(row, [2**32 - 2] * 4)


NO_NUMBERS = [
    (F32, 1e39),
    (I32, 0.5),
    (I32, 2**32),
    (I32, -(2**31) - 1),
    (I8, 256),
    (I64, float("inf")),
    (I64, float("nan")),
    (vector(I32, 4), 1.5),
]


@pytest.mark.parametrize(("type", "number"), NO_NUMBERS)
def test_numbers_that_a_type_lacks(type: Type, number: float) -> None:
    with pytest.raises(DjptError, match=r"has no number"):
        evaluate(lambda f: [f.constant(type, number)])


# ---- other forms of values ---------------------------------------------------------------------


def test_numbers_change_their_type() -> None:
    whole, real = np.uint32([0, 7, 300, 2**32 - 1]), np.float64([0, 0.1, 3.99, 2**24 + 1])
    found = evaluate(
        lambda _, x, y: [x.to(I64), x.to(I8), x.to(F32), x.to(F64), y.to(F32), y.to(I32), y.to(I64), y.to(F32).to(F64)],
        whole,
        real,
    )
    expected = [
        *(whole.astype(d) for d in ("u8", "u1", "f4", "f8")),
        *(real.astype(d) for d in ("f4", "u4", "u8")),
        real.astype("f4").astype("f8"),
    ]
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)


def test_a_value_of_the_same_type_needs_no_instruction() -> None:
    def build(_: Function, x: Value) -> list[Value]:
        assert x.to(I32) is x
        return [x]

    evaluate(build, np.uint32(1))


def test_whole_numbers_are_signed() -> None:
    (found,) = evaluate(lambda _, x: [x.whole()], np.float32([-1.9, -0.5, 0.5, 2.9]))
    np.testing.assert_array_equal(found.view(np.int32), [-1, 0, 0, 2])


def test_bits_as_another_type() -> None:
    x, words = np.float32([1, -2, 0.5, np.inf]), vector(I32, 4)
    bits, pairs, back = evaluate(
        lambda _, v: [v.bits_as(words), v.bits_as(vector(I64, 2)), v.bits_as(words).bits_as(v.type)], x
    )
    np.testing.assert_array_equal(bits, x.view(np.uint32))
    np.testing.assert_array_equal(pairs, x.view(np.uint64))
    np.testing.assert_array_equal(back, x)


def test_masks_are_bits() -> None:
    mask = np.array([1, 0, 0, 1, 1, 0, 1, 0], bool)
    bits, inverse, both, any_, none = evaluate(
        lambda _, m, o: [m.bits_as(I8), ~m, m & o, ar.any_of(m), ar.any_of(m & ~m)], mask, ~mask | (np.arange(8) < 2)
    )
    assert bits == 0b01011001
    np.testing.assert_array_equal(inverse, ~mask)
    np.testing.assert_array_equal(both, mask & (np.arange(8) < 2))
    assert any_ and not none


def test_masks_of_a_few_lanes() -> None:
    (found,) = evaluate(lambda _, m: [ar.any_of(m)], np.array([False, False, True]))
    assert found


def test_lanes_and_shuffles() -> None:
    x, y = np.float32([1, 2, 3, 4]), np.float32([5, 6, 7, 8])
    found = evaluate(
        lambda _, a, b, k: [
            a.lane(2),
            a.lane(k),
            a.shuffled([3, 3, 0]),
            a.shuffled([0, 4, 1, 7, 3, 6], b),
            a.lane(1).spread(8),
        ],
        x,
        y,
        np.uint32(3),
    )
    assert found[0] == 3 and found[1] == 4
    for ours, theirs in zip(found[2:], ([4, 4, 1], [1, 5, 2, 8, 4, 7], [2] * 8), strict=True):
        np.testing.assert_array_equal(ours, theirs)


# ---- functions of values -----------------------------------------------------------------------


@pytest.mark.parametrize("dtype", FLOATS)
def test_functions_of_floats(dtype: str) -> None:
    x = np.array([4, -0.25, 2, -0.0, np.inf, np.nan, 1e-30, -7], dtype)
    y = x[::-1].copy()
    found = evaluate(
        lambda _, a, b: [
            *(ar.sqrt(a), ar.abs(a), ar.rcp(a), ar.copysign(a, b), ar.copysign(3.0, b)),
            *(ar.minimum(a, b), ar.maximum(a, b), ar.minimum(a, 1.0), ar.maximum(1.0, a), ar.select(a < b, a, 0.0)),
        ],
        x,
        y,
    )
    with np.errstate(all="ignore"):
        expected = [
            *(np.sqrt(x), np.abs(x), 1 / x, np.copysign(x, y), np.copysign(x.dtype.type(3), y)),
            *(np.where(x < y, x, y), np.where(x > y, x, y), np.where(x < 1, x, 1), np.where(1 > x, 1, x)),  # noqa: SIM300
            np.where(x < y, x, 0),
        ]
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_the_second_number_is_taken_if_either_is_nan() -> None:
    nan, one = np.float32(np.nan), np.float32(1)
    found = evaluate(lambda _, x, y: [ar.minimum(x, y), ar.minimum(y, x), ar.maximum(x, y), ar.maximum(y, x)], nan, one)
    np.testing.assert_array_equal(found, [1, np.nan, 1, np.nan])


def test_bits_are_counted() -> None:
    x = np.uint32([1, 0x80000000, 12, 0xFFFFFFFF])
    lowest, length = evaluate(lambda _, v: [ar.lowest_bit(v), ar.bit_length(v)], x)
    np.testing.assert_array_equal(lowest, [0, 31, 2, 0])
    np.testing.assert_array_equal(length, [1, 32, 4, 32])
    assert evaluate(lambda _, v: [ar.bit_length(v)], np.uint64(0)) == [0]


def test_conditions_and_smallest() -> None:
    x = np.float32([3, 1, 2, 5])
    smallest, everywhere = evaluate(
        lambda _, v: [ar.smallest([v.lane(k) for k in range(4)]), ar.all_of([v > 1, v < 5, v != 2])], x
    )
    assert smallest == 1
    np.testing.assert_array_equal(everywhere, [True, False, False, False])


def test_select_spreads_scalars_over_a_mask() -> None:
    mask = np.array([True, False, True, True])
    of_scalars, of_numbers, of_vectors = evaluate(
        lambda f, m, a, b: [
            ar.select(m, a, b),
            ar.select(m, a, 0.5),
            ar.select(a < b, a.spread(4), b.spread(4)),
        ],
        mask,
        np.float32(1),
        np.float32(2),
    )
    np.testing.assert_array_equal(of_scalars, [1, 2, 1, 1])
    np.testing.assert_array_equal(of_numbers, [1, 0.5, 1, 1])
    np.testing.assert_array_equal(of_vectors, [1] * 4)


def test_gather_reads_where_the_mask_is_set() -> None:
    table = np.arange(100, dtype=np.float32)
    mask, offsets = np.array([True, False, True, True]), np.uint64([4, 2**60, 0, 396])
    (found,) = evaluate(
        lambda f, base, m, o: [
            ar.gather(f.emit(f"inttoptr {base} to ptr", PTR).at(o), m, f.constant(vector(F32, 4), -1.0))
        ],
        np.uint64(table.ctypes.data),
        mask,
        offsets,
    )
    np.testing.assert_array_equal(found, [1, -1, 0, 99])


# ---- memory ------------------------------------------------------------------------------------


def test_memory_is_read_and_written() -> None:
    module = Module()
    with module.function("reverse", [("source", PTR), ("target", PTR), ("count", I64)]) as f:
        source, target, count = f.parameters
        with f.each(0, count) as i:
            f.prefetch(source.at((i + 8) * 4))
            f.store(f.load(F32, source.at(i * 4)), target.at((count - 1 - i) * 4))
    data = np.arange(11, dtype=np.float32)
    out = np.zeros(11, np.float32)
    callable_from(module, "reverse", "ppi", None)(data.ctypes.data, out.ctypes.data, 11)
    np.testing.assert_array_equal(out, data[::-1])


@pytest.mark.parametrize("type", [F32, F64, I1, I8, I32, I64, *(vector(F32, k) for k in (2, 3, 4, 5, 8, 16))])
def test_variables_and_arrays_of_all_types(type: Type) -> None:
    """Neighbours on the stack stay as they are."""

    def build(f: Function, k: Value) -> list[Value]:
        before, changing, after = f.variable(type, 1), f.variable(type, 0), f.variable(type, 1)
        array = f.array(type, 3)
        for place in range(3):
            array[place] = 0
        changing.value = 1
        changing.value = changing.value
        array[k] = changing.value
        same = [before.value == 1, changing.value == 1, after.value == 1, array[0] == 0, array[1] == 1, array[2] == 0]
        return [ar.any_of(~x) if x.type.lanes else ~x for x in same]

    assert not any(evaluate(build, np.uint64(1)))


def test_a_vector_over_the_elements_of_an_array() -> None:
    def build(f: Function, row: Value, k: Value) -> list[Value]:
        array = f.array(F32, 8)
        array.store(row)
        array[k] = 10.0
        array[k + 1] = row.lane(0)
        return [f.load(row.type, array.address)]

    (found,) = evaluate(build, np.arange(8, dtype=np.float32) + 1, np.uint32(2))
    np.testing.assert_array_equal(found, [1, 2, 10, 1, 5, 6, 7, 8])
