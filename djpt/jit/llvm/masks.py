"""The mask that Dr.Jit applies to memory operations of symbolic loops."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr

from djpt.jit.llvm.drjit_internals import function, missing
from djpt.jit.types import Float

__all__ = ["all_lanes", "can_unmask"]


def can_unmask() -> bool:
    """True if `all_lanes` works: on processors, with the versions of Dr.Jit that it knows.

    Dr.Jit 1.5 writes wrong IR where local memory for `Bool` has a mask, so constant masks must vanish. They stay if its
    flags say that constants aren't propagated, or in debug mode.
    """
    folds = dr.flag(dr.JitFlag.ConstantPropagation) and not dr.flag(dr.JitFlag.Debug)
    return (
        dr.backend_v(Float) == dr.JitBackend.LLVM
        and folds
        and not missing("mask_push", "mask_pop", "mask_default", "release")
    )


@contextmanager
def all_lanes(count: int) -> Iterator[None]:
    """Let what is written to local memory inside be written for all `count` lanes of the kernel.

    Within a symbolic loop lanes that have left it would keep what they have, which takes a select for each number.
    """
    backend = dr.JitBackend.LLVM.value
    mask = function("mask_default")(backend, count)
    function("mask_push")(backend, mask)
    try:
        yield
    finally:
        function("mask_pop")(backend)
        function("release")(mask)
