"""Functions of `djpt.jit.llvm.ir`, compiled and called with numbers of NumPy."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.jit.llvm.compiler import compiled
from djpt.jit.llvm.ir import F32, F64, I1, I8, I32, I64, PTR, Function, Module, Type, Value, vector

__all__ = ["TYPES", "callable_from", "evaluate", "integer_function"]

TYPES = {np.dtype(d): t for d, t in (("f4", F32), ("f8", F64), ("u1", I8), ("u4", I32), ("u8", I64), ("?", I1))}
"""The types of arrays' elements."""

ROOM = 128
"""Bytes for each input and output."""


def evaluate(build: Callable[..., Sequence[Value]], *inputs: Any) -> list[NDArray[Any]]:
    """The results of a function `build(f, *values)`.

    Arrays of one dimension are vectors, those of none scalars. Masks go in and out as booleans.
    """
    arrays = [np.asarray(x) for x in inputs]
    module = Module()
    with module.function("run", [("source", PTR), ("target", PTR)]) as f:
        source, target = f.parameters
        results = build(f, *(parameter(f, source.at(ROOM * k), x) for k, x in enumerate(arrays)))
        for k, result in enumerate(results):
            f.store(result.to(I8) if result.type.bits == 1 else result, target.at(ROOM * k))
    memory = np.zeros((len(arrays), ROOM), np.uint8)
    for row, array in zip(memory, arrays, strict=True):
        content = np.atleast_1d(array).view(np.uint8)
        row[: len(content)] = content
    made = np.zeros((len(results), ROOM), np.uint8)
    callable_from(module, "run", "pp", None)(memory.ctypes.data, made.ctypes.data)
    return [as_array(result.type, row) for result, row in zip(results, made, strict=True)]


def parameter(f: Function, address: Value, array: NDArray[Any]) -> Value:
    """An input."""
    type = I8 if array.dtype == bool else TYPES[array.dtype]
    value = f.load(vector(type, len(array)) if array.ndim else type, address)
    return value != 0 if array.dtype == bool else value


def as_array(type: Type, row: NDArray[np.uint8]) -> NDArray[Any]:
    """An output."""
    dtype = next(d for d, t in TYPES.items() if t == type.element)
    values = row[: max(type.lanes, 1) * dtype.itemsize].view(dtype)
    return values if type.lanes else values[0]


CTYPES = {"p": ctypes.c_void_p, "i": ctypes.c_uint64, "w": ctypes.c_uint32, "f": ctypes.c_float, "d": ctypes.c_double}


def callable_from(module: Module, name: str, parameters: str, result: str | None) -> Callable[..., Any]:
    """A function of a module; one letter for each parameter: p, i (I64), w (I32), f or d."""
    prototype = ctypes.CFUNCTYPE(CTYPES[result] if result else None, *(CTYPES[letter] for letter in parameters))
    return prototype(compiled(module.text(), (name,))[name])


def integer_function(build: Callable[..., None], count: int = 1) -> Callable[..., int]:
    """A function of `count` integers, of 64 bits like its result, whose body is built by `build(f, *parameters)`."""
    module = Module()
    with module.function("run", [(f"x{k}", I64) for k in range(count)], I64) as f:
        build(f, *f.parameters)
    return callable_from(module, "run", "i" * count, "i")
