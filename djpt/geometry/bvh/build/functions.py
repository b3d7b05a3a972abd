"""The machine code of trees' construction, compiled once, as functions that Python can call.

They take addresses as integers, and let other threads of Python run while they work.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from types import SimpleNamespace

from djpt.geometry.bvh.build.build_functions import add_build_functions
from djpt.geometry.bvh.build.collapse_functions import add_plan, add_weigh
from djpt.geometry.bvh.build.fit_functions import add_fit_functions
from djpt.geometry.bvh.build.row_functions import add_row_functions
from djpt.jit.llvm.compiler import CompilationError, compiled
from djpt.jit.llvm.ir import Module
from djpt.jit.llvm.lanes import target

__all__ = ["can_compile", "functions"]

CTYPES = {"p": ctypes.c_void_p, "i": ctypes.c_int64, "f": ctypes.c_float}

MODULES: tuple[tuple[tuple[Callable[[Module], None], ...], dict[str, str]], ...] = (
    (
        (add_build_functions,),
        {"bounds": "piipp", "prepare": "piipp", "split": "ppppiii", "grow": "ppppiii"},
    ),
    (
        (add_weigh, add_plan, add_fit_functions, add_row_functions),
        {
            "weigh": "piif",
            "plan": "pippppp",
            "emit": "ppppppiii",
            "fit": "ppppppiiip",
            "take_corners": "piip",
            "invert": "piip",
            "write_rows": "piipppi",
        },
    ),
)
"""For each module what fills it, and the parameters of its functions: pointers, integers and floats.

All results are integers. The modules take about the same time to compile.
"""


@cache
def functions() -> SimpleNamespace:
    """The functions by name, see the modules that define them; compiled at the first call, on two threads."""
    texts, names = [], []
    for additions, signatures in MODULES:
        module = Module()
        for add in additions:
            add(module)
        texts.append(module.text())
        names.append(tuple(signatures))
    target()  # which other threads may not be able to ask for
    result = SimpleNamespace()
    with ThreadPoolExecutor(len(texts)) as team:
        for addresses, (_, signatures) in zip(team.map(compiled, texts, names), MODULES, strict=True):
            for name, letters in signatures.items():
                of_type = ctypes.CFUNCTYPE(ctypes.c_int64, *(CTYPES[letter] for letter in letters))
                setattr(result, name, of_type(addresses[name]))
    return result


@cache
def can_compile() -> bool:
    """Whether the functions can be compiled on this machine: LLVM, or Dr.Jit's description of it, may be missing."""
    try:
        functions()
    except (CompilationError, OSError, AttributeError):
        return False
    return True
