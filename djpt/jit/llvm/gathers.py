"""Gathers by the processor's instruction, for processors on which LLVM takes them for slow."""

from __future__ import annotations

from djpt.jit.llvm.drjit_internals import function, missing

__all__ = ["gather_by_instruction"]

FAST = "+fast-gather"
"""LLVM's name of the feature: gathers are faster than a load per lane."""


def gather_by_instruction() -> None:
    """Compile gathers of all kernels from now on to AVX2's instruction, where the processor has it.

    By itself LLVM does so for Intel's processors, and with AVX-512. For others, such as AMD's up to Zen 3, it makes
    eight branches of each masked gather. Splitting a block takes time that goes with the length of what follows, so
    kernels with hundreds of gathers compile in a third to a twelfth of the time with the instruction. They run as fast
    or faster, and compute the same bits. Dr.Jit must have loaded LLVM.
    """
    # Without these functions kernels compute the same.
    if missing("target_cpu", "target_features", "set_target", "vector_width"):
        return
    features = (function("target_features")() or b"").decode().split(",")
    if "+avx2" in features and not {"+avx512f", FAST} & set(features):
        listed = ",".join([*features, FAST]).encode()
        function("set_target")(function("target_cpu")(), listed, function("vector_width")())
