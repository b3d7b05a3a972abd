"""Kernels of a chosen width, to test on one machine what others compute.

``DJPT_TEST_LANES=8 python -m pytest`` compiles all kernels as for a processor with AVX2 and without AVX-512. Besides
the width, its approximate square root differs, so results differ in their last bits.
"""

from __future__ import annotations

import ctypes
import os

from djpt.llvm import lanes
from djpt.variants import load_backend

__all__ = ["VARIABLE", "force_lanes", "lanes_from_environment"]

VARIABLE = "DJPT_TEST_LANES"
"""The environment variable for the number of lanes, 8 or 16. Processes that a test starts ignore it."""

WIDER = {8: ("avx512", "amx", "avx10"), 16: ("amx",)}
"""Features that processors with this number of lanes lack, by the beginnings of their names."""
PROCESSORS = {8: "haswell", 16: "skylake-avx512"}


def lanes_from_environment() -> None:
    """Force the width that `VARIABLE` asks for, if it is set; before the first kernel of the process."""
    asked = os.environ.get(VARIABLE)
    if asked:
        force_lanes(int(asked))


def force_lanes(count: int) -> None:
    """Compile all kernels from now on for `count` lanes: 8 (AVX2) or 16 (AVX-512).

    Raises:
        ValueError: Another count, or this processor lacks the instructions.
    """
    load_backend()
    if count not in PROCESSORS:
        raise ValueError(f"{VARIABLE} must be 8 or 16, found {count}")
    needed = {8: "+avx2", 16: "+avx512f"}[count]
    if needed not in lanes.features():
        raise ValueError(f"{VARIABLE}={count}: this processor lacks {needed[1:]}")
    kept = [f"-{name[1:]}" if name[1:].startswith(WIDER[count]) else name for name in lanes.features()]
    set_target = lanes.core()._Z19jit_llvm_set_targetPKcS0_j
    set_target.argtypes, set_target.restype = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_uint32], None
    set_target(PROCESSORS[count].encode(), ",".join(kept).encode(), count)
    if lanes.lane_count() != count:
        raise RuntimeError(f"Dr.Jit has {lanes.lane_count()} lanes and not {count}")
