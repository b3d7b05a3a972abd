"""Loops, conditions, early returns and functions, built with operators, do what Python does."""

from __future__ import annotations

import numpy as np

from djpt.jit.llvm.ir import F32, F64, I32, I64, PTR, Function, Module, Value
from tests.kit.ir import callable_from, integer_function

# ---- control flow ------------------------------------------------------------------------------


def test_when_and_either() -> None:
    def build(f: Function, x: Value) -> None:
        result = f.variable(I64, 0)
        with f.when(x > 10):
            result.value = 100
        with f.either((x & 1) == 0) as branch:
            result.value = result.value + 1
            with f.when(x == 4):
                result.value = result.value + 50
            branch.otherwise()
            result.value = result.value + 2
        with f.either(x == 3):
            result.value = result.value + 7
        f.give(result.value)

    run = integer_function(build)
    assert [run(x) for x in (2, 3, 4, 12, 13)] == [1, 9, 51, 101, 102]


def test_early_returns() -> None:
    def build(f: Function, x: Value) -> None:
        with f.when(x == 0):
            f.give(7)
        with f.either(x == 1) as branch:
            f.give(8)
            branch.otherwise()
            with f.loop():
                f.give(x * 2)
        f.give(9)

    run = integer_function(build)
    assert [run(x) for x in (0, 1, 2, 50)] == [7, 8, 4, 100]


def test_what_follows_a_jump_is_left_out() -> None:
    def build(f: Function, x: Value) -> None:
        result = f.variable(I64, x)
        with f.loop() as turns:
            turns.stop()
            result.value = 0
        f.give(result.value)
        result.value = 1
        f.give(result.value)

    assert integer_function(build)(5) == 5


def test_loops_over_numbers() -> None:
    def build(f: Function, first: Value, end: Value) -> None:
        up, down = f.variable(I64, 1), f.variable(I64, 1)
        with f.each(first, end) as i:
            up.value = up.value * 3 + i
        with f.each_backwards(first, end) as i:
            down.value = down.value * 3 + i
        f.give(up.value * 1000_000 + down.value)

    def expected(first: int, end: int) -> int:
        up = down = 1
        for i in range(first, end):
            up = up * 3 + i
        for i in reversed(range(first, end)):
            down = down * 3 + i
        return up * 1000_000 + down

    run = integer_function(build, 2)
    for first, end in ((0, 0), (0, 1), (2, 9), (5, 3), (0, 10)):
        assert run(first, end) == expected(first, end)


def test_a_loop_may_end_at_the_largest_number() -> None:
    def build(f: Function, x: Value) -> None:
        total = f.variable(I64, 0)
        with f.each(x, -1) as i:
            total.value = total.value + (-1 - i)
        f.give(total.value)

    assert integer_function(build)(2**64 - 5) == 4 + 3 + 2 + 1


def test_nested_loops_can_be_left_and_begun_again_from_inside() -> None:
    def build(f: Function, n: Value) -> None:
        total = f.variable(I64, 0)
        row = f.variable(I64, 0)
        with f.loop() as rows:
            row.value = row.value + 1
            rows.stop_if(row.value > n)
            with f.each(0, 10) as column:
                with f.when(column == 5):
                    rows.again()
                with f.when(column * row.value == 36):
                    rows.stop()
                with f.loop() as inner:
                    inner.stop_if(column % 2 == 0)
                    total.value = total.value + column
                    inner.stop()
                total.value = total.value + 100
            total.value = 0
        f.give(total.value)

    def expected(n: int) -> int:
        total = 0
        for row in range(1, n + 1):
            for column in range(5):
                if column * row == 36:
                    return total
                total += (column if column % 2 else 0) + 100
        return total

    run = integer_function(build)
    for n in (0, 1, 3, 20):
        assert run(n) == expected(n)


def test_again_if_skips_the_rest_of_a_turn() -> None:
    def build(f: Function, n: Value) -> None:
        total, i = f.variable(I64, 0), f.variable(I64, 0)
        with f.loop() as turns:
            turns.stop_if(i.value == n)
            i.value = i.value + 1
            turns.again_if(i.value % 3 == 0)
            total.value = total.value + i.value
        f.give(total.value)

    assert integer_function(build)(10) == sum(i for i in range(1, 11) if i % 3)


def test_variables_inside_loops_begin_anew_in_every_turn() -> None:
    def build(f: Function, n: Value) -> None:
        total = f.variable(I64, 0)
        with f.each(0, n):
            fresh = f.variable(I64, 5)
            total.value = total.value + fresh.value
            fresh.value = 1000
        f.give(total.value)

    # A place on the stack is taken once, not in every turn.
    assert integer_function(build)(10_000_000) == 50_000_000


# ---- functions -----------------------------------------------------------------------------------


def test_functions_call_each_other() -> None:
    module = Module()
    with module.function("factorial", [("n", I64)], I64, internal=True) as f:
        (n,) = f.parameters
        with f.when(n <= 1):
            f.give(1)
        below = f.call("factorial", [n - 1], I64)
        assert below is not None
        f.give(n * below)
    with module.function("note", [("place", PTR), ("value", I64)], internal=True) as f:
        f.store(f.parameters[1], f.parameters[0])
    with module.function("run", [("n", I64), ("place", PTR)]) as f:
        n, place = f.parameters
        result = f.call("factorial", [n], I64)
        assert result is not None
        assert f.call("note", [place, result]) is None
    made = np.zeros(1, np.uint64)
    callable_from(module, "run", "ip", None)(10, made.ctypes.data)
    assert made[0] == 3628800


def test_parameters_may_have_any_names() -> None:
    """Also those that labels and places on the stack have inside."""
    names = ("entry", "body", "b1", "b2", "v1", "v2", "m0")
    module = Module()
    with module.function("run", [(name, I64) for name in names], I64) as f:
        total = f.variable(I64, 0)
        for value in f.parameters:
            with f.when(value > 1):
                total.value = total.value + value
        f.give(total.value)
    assert callable_from(module, "run", "iiiiiii", "i")(*range(7)) == 2 + 3 + 4 + 5 + 6


def test_parameters_and_results_of_all_kinds() -> None:
    module = Module()
    with module.function("run", [("a", F32), ("b", F64), ("c", I32), ("d", I64)], F64) as f:
        a, b, c, d = f.parameters
        f.give(a.to(F64) + b * c.to(F64) - d.to(F64))
    assert callable_from(module, "run", "fdwi", "d")(0.5, 0.1, 3, 2) == 0.5 + 0.1 * 3 - 2
