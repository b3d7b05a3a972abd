"""Mistakes in code that is built with operators are found as it is built."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import pytest

from djpt.errors import DjptError
from djpt.jit.llvm import arithmetic as ar
from djpt.jit.llvm.compiler import CompilationError
from djpt.jit.llvm.ir import F32, F64, I32, I64, PTR, Function, Module, Type, Value
from tests.kit.ir import integer_function


def built(build: Callable[[Function], Any], result: Type | None = None) -> Module:
    module = Module()
    with module.function("run", [("a", I32), ("b", I64), ("x", F32), ("p", PTR), ("d", F64)], result) as f:
        build(f)
    return module


def assigned(f: Function, type: Type, value: Value) -> None:
    f.variable(type, 0).value = value


MIXED: dict[str, Callable[[Function], Any]] = {
    "i32 + i64": lambda f: f.parameters[0] + f.parameters[1],
    "i64 * float": lambda f: f.parameters[1] * f.parameters[2],
    "float < double": lambda f: f.parameters[2] < f.parameters[4],
    "lanes": lambda f: f.parameters[2].spread(4) + f.parameters[2].spread(8),
    "elements": lambda f: f.parameters[2].spread(4) + f.parameters[0],
    "select": lambda f: ar.select(f.parameters[0] == 0, f.parameters[0], f.parameters[1]),
    "fma": lambda f: ar.fma(f.parameters[2], f.parameters[4], f.parameters[2]),
    "a variable": lambda f: assigned(f, F32, f.parameters[1]),
    "an array": lambda f: operator.setitem(f.array(I32, 4), 0, f.parameters[1]),
    "no vector": lambda f: assigned(f, F32, f.parameters[2].spread(4)),
    "bounds": lambda f: f.each(f.parameters[0], 10).__enter__(),
}


@pytest.mark.parametrize("name", MIXED)
def test_operands_of_different_types(name: str) -> None:
    with pytest.raises(DjptError, match="operands of different types"):
        built(MIXED[name])


def test_a_result_of_another_type() -> None:
    with pytest.raises(DjptError, match="operands of different types, float and i32"):
        built(lambda f: f.give(f.parameters[0]), F32)


MISSING: dict[str, Callable[[Function], Any]] = {
    "'div' of i32": lambda f: f.parameters[0] / f.parameters[0],
    "'udiv' of float": lambda f: f.parameters[2] // f.parameters[2],
    "'and' of float": lambda f: f.parameters[2] & f.parameters[2],
    "'shl' of float": lambda f: f.parameters[2] << f.parameters[2],
    "'div' of <4 x i32>": lambda f: f.parameters[0].spread(4) / 2,
    "'add' of ptr": lambda f: f.parameters[3] + f.parameters[3],
}


@pytest.mark.parametrize("words", MISSING)
def test_operations_that_a_type_lacks(words: str) -> None:
    with pytest.raises(DjptError, match=f"no operation {words}"):
        built(MISSING[words])


def test_an_address_is_no_number() -> None:
    with pytest.raises(DjptError, match="can't be a constant of type ptr"):
        built(lambda f: f.parameters[3] == 0)


def test_a_value_is_neither_true_nor_false_while_code_is_built() -> None:
    with pytest.raises(TypeError, match=r"use when\(\) or select\(\)"):
        built(lambda f: bool(f.parameters[0] == 1))
    with pytest.raises(TypeError, match="unhashable"):
        built(lambda f: hash(f.parameters[0]))


def test_a_function_that_fails_isnt_added() -> None:
    module = Module()
    with pytest.raises(ValueError, match="stop"), module.function("run", []):
        raise ValueError("stop")
    assert "run" not in module.text()


def test_values_are_used_where_they_have_been_computed() -> None:
    def build(f: Function, x: Value) -> None:
        with f.when(x > 1):
            inside = x + 1
        f.give(inside)

    with pytest.raises(CompilationError, match="does not dominate all uses"):
        integer_function(build)
