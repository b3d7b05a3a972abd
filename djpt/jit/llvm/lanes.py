"""The width of the kernels of Dr.Jit's LLVM backend: the lanes that one instruction works on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import NamedTuple

import drjit as dr

from djpt.errors import BackendError
from djpt.jit.backends import VARIANTS, variant
from djpt.jit.frozen import recording
from djpt.jit.llvm.drjit_internals import function, missing

__all__ = [
    "BLOCK",
    "INSTRUCTION_SETS",
    "force_lanes",
    "instruction_set",
    "lane_count",
    "small_blocks",
    "target",
]

INSTRUCTION_SETS = {"avx512f": "AVX-512", "avx2": "AVX2", "avx": "AVX", "sse4.2": "SSE4.2", "neon": "NEON"}
"""LLVM's names of features, the widest first, and what the instruction sets are called."""

WIDER = {8: ("avx512", "amx", "avx10"), 16: ("amx",)}
"""Features that processors with this number of lanes lack, by the beginnings of their names."""
PROCESSORS = {8: "haswell", 16: "skylake-avx512"}

BLOCK = 1024
"""Lanes that a thread usually takes at a time in `small_blocks`."""


def lane_count() -> int:
    """The lanes of a vector: 16 with AVX-512, 8 with AVX2, 4 with NEON. The LLVM backend must have been loaded."""
    return int(function("vector_width")())


@contextmanager
def small_blocks(lanes: int = BLOCK) -> Iterator[None]:
    """Let threads take work in small portions, of so many lanes, in kernels that are launched inside.

    The portions of Dr.Jit, 2^14 lanes, suit lanes that all take the same time. GPUs have no such portions. While
    `dr.freeze` records, the portions become small for good: Dr.Jit will launch the same kernels without asking.
    """
    # Without these functions only the threads' shares are less even.
    if VARIANTS[variant()] != "llvm" or missing("block_size", "set_block_size"):
        yield
        return
    usual, set_size = function("block_size")(), function("set_block_size")
    set_size(lanes)
    try:
        yield
    finally:
        if not recording():
            set_size(usual)


class Target(NamedTuple):
    """The processor that kernels are compiled for, and the compiler."""

    processor: str
    """LLVM's name of the processor, such as ``znver3``."""
    features: tuple[str, ...]
    """LLVM's names of its features, such as ``+avx2``, ``-avx512f``."""
    version: str
    """The version of LLVM."""


@cache
def target() -> Target:
    """The target of kernels.

    Ask for it before functions are compiled in other threads: while Dr.Jit records a frozen function it answers this
    thread alone, and others would wait for ever.
    """
    name, listed = (str((function(ask)() or b"").decode()) for ask in ("target_cpu", "target_features"))
    return Target(name, tuple(listed.split(",")), str(dr.detail.llvm_version()))


def instruction_set() -> str:
    """The widest instruction set that kernels may use, one of `INSTRUCTION_SETS`; empty if it is none of them."""
    there = target().features
    return next((name for feature, name in INSTRUCTION_SETS.items() if f"+{feature}" in there), "")


def force_lanes(count: int) -> None:
    """Compile all kernels from now on for `count` lanes, to measure or test what other processors run.

    8 (AVX2) or 16 (AVX-512). The LLVM backend must have been loaded.

    Raises:
        BackendError: Kernels run on a GPU.
        ValueError: Another count, or this processor lacks the instructions.
    """
    if VARIANTS[variant()] != "llvm":
        raise BackendError(f"the number of lanes can be chosen for processors, not for variant {variant()!r}")
    if count not in PROCESSORS:
        raise ValueError(f"the number of lanes must be 8 or 16, found {count}")
    needed = {8: "+avx2", 16: "+avx512f"}[count]
    if needed not in target().features:
        raise ValueError(f"{count} lanes: this processor lacks {needed[1:]}")
    kept = [f"-{name[1:]}" if name[1:].startswith(WIDER[count]) else name for name in target().features]
    function("set_target")(PROCESSORS[count].encode(), ",".join(kept).encode(), count)
    target.cache_clear()
    if lane_count() != count:
        raise RuntimeError(f"Dr.Jit has {lane_count()} lanes and not {count}")
