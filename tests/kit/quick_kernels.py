"""Kernels that LLVM translates as they are, which takes half the time of optimised ones.

``DJPT_TEST_QUICK=1 python -m pytest`` skips the passes of LLVM that only make code faster: Dr.Jit writes the same
kernels, they compute the same numbers, and run two to three times as long. Compiling is most of the time of the tests.
"""

from __future__ import annotations

import ctypes
import os

from tests.kit.processes import ROOT

__all__ = ["VARIABLE", "keep_apart", "skip_passes", "without_notes"]

VARIABLE = "DJPT_TEST_QUICK"
"""The environment variable that asks for such kernels. Processes that a test starts compile as ever."""

OPTIONS = ("-opt-bisect-limit=0", "-regalloc=fast", "-optimize-regalloc=false", "-disable-cgp", "-disable-lsr")
"""No optional pass, registers given out block by block, and no analyses for two passes that would be skipped anyway.

Not ``-pre-RA-sched=linearize``, which is a little faster: kernels of meshes then compute other numbers.
"""

NOTE = "BISECT: "
"""How the lines begin that LLVM prints to the error output for each pass that it skips."""


def keep_apart() -> None:
    """Let such kernels have a cache of their own, since users mustn't get them; before Dr.Jit is imported."""
    if os.environ.get(VARIABLE):
        os.environ["DRJIT_CACHE_DIR"] = str(ROOT / "build" / "kernels")


def skip_passes() -> None:
    """Tell LLVM to skip all optional passes if `VARIABLE` is set; after djpt has chosen the library."""
    path = os.environ.get("DRJIT_LIBLLVM_PATH")
    if os.environ.get(VARIABLE) and path:
        words = [option.encode() for option in ("tests", *OPTIONS)]
        arguments = (ctypes.c_char_p * len(words))(*words)
        ctypes.CDLL(path).LLVMParseCommandLineOptions(len(arguments), arguments, None)


def without_notes(text: str) -> str:
    """What was printed, less LLVM's lines about skipped passes."""
    return "".join(line for line in text.splitlines(keepends=True) if not line.startswith(NOTE))
