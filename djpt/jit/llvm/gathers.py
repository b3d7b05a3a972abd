"""Gathers by the processor's instruction, for processors on which LLVM takes them for slow."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from djpt.jit.llvm.drjit_internals import function, missing

__all__ = ["gather_as_llvm_does", "gather_by_instruction"]

FAST = "+fast-gather"
"""LLVM's name of the feature: gathers are faster than a load per lane."""


def gather_by_instruction() -> None:
    """Compile gathers of all kernels from now on to AVX2's instruction, where the processor has it.

    By itself LLVM does so for Intel's processors, and with AVX-512. For others, such as AMD's up to Zen 3, it makes
    eight branches of each masked gather. Splitting a block takes time that goes with the length of what follows, so
    kernels with hundreds of gathers compile in a third to a twelfth of the time with the instruction. They run as fast
    or faster, and compute the same bits. Dr.Jit must have loaded LLVM.
    """
    listed = features()
    if "+avx2" in listed and not {"+avx512f", FAST} & set(listed):
        compile_for([*listed, FAST])


@contextmanager
def gather_as_llvm_does() -> Iterator[None]:
    """Compile kernels inside with the gathers that LLVM chooses by itself.

    What `gather_by_instruction` asks for holds for all kernels of the process, those of other programs included, and
    makes Mitsuba faster. Comparisons of speed measure it as it is without djpt.
    """
    listed = features()
    if FAST not in listed:
        yield
        return
    compile_for([name for name in listed if name != FAST])
    try:
        yield
    finally:
        compile_for(listed)


def features() -> list[str]:
    """The features that kernels are compiled for; none if Dr.Jit lacks the functions to change them."""
    # Without these functions kernels compute the same.
    if missing("target_cpu", "target_features", "set_target", "vector_width"):
        return []
    return (function("target_features")() or b"").decode().split(",")


def compile_for(listed: list[str]) -> None:
    """Compile kernels from now on for a processor with other features."""
    function("set_target")(function("target_cpu")(), ",".join(listed).encode(), function("vector_width")())
