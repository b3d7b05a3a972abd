"""The mask that Dr.Jit applies to memory operations of symbolic loops."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import drjit as dr

from djpt.llvm.lanes import core_path
from djpt.types import Float

__all__ = ["all_lanes", "can_unmask"]

SYMBOLS = {
    "push": "_Z17jit_var_mask_push10JitBackendj",
    "pop": "_Z16jit_var_mask_pop10JitBackend",
    "default": "_Z20jit_var_mask_default10JitBackendm",
    "release": "_Z20jit_var_dec_ref_implj",
}
"""Functions of Dr.Jit's core that are exported but undocumented."""


@cache
def core() -> dict[str, Any] | None:
    """The functions of `SYMBOLS`; None if this version of Dr.Jit lacks one."""
    try:
        # With the interpreter's lock held: these functions use Dr.Jit's state of the thread.
        library = ctypes.PyDLL(core_path())
        found: dict[str, Any] = {name: library[symbol] for name, symbol in SYMBOLS.items()}
    except (OSError, AttributeError):
        return None
    backend, word = ctypes.c_int, ctypes.c_uint32
    found["push"].argtypes, found["push"].restype = [backend, word], None
    found["pop"].argtypes, found["pop"].restype = [backend], None
    found["default"].argtypes, found["default"].restype = [backend, ctypes.c_size_t], word
    found["release"].argtypes, found["release"].restype = [word], None
    return found


def can_unmask() -> bool:
    """Whether `all_lanes` works: on processors, with the versions of Dr.Jit that it knows.

    Dr.Jit 1.5 writes wrong IR where local memory for `Bool` has a mask, so constant masks must vanish. They stay if its
    flags say that constants aren't propagated, or in debug mode.
    """
    folds = dr.flag(dr.JitFlag.ConstantPropagation) and not dr.flag(dr.JitFlag.Debug)
    return dr.backend_v(Float) == dr.JitBackend.LLVM and folds and core() is not None


@contextmanager
def all_lanes(count: int) -> Iterator[None]:
    """Let what is written to local memory inside be written for all `count` lanes of the kernel.

    Within a symbolic loop lanes that have left it would keep what they have, which takes a select for each number.
    """
    functions = core()
    assert functions is not None
    backend = dr.JitBackend.LLVM.value
    mask = functions["default"](backend, count)
    functions["push"](backend, mask)
    try:
        yield
    finally:
        functions["pop"](backend)
        functions["release"](mask)
