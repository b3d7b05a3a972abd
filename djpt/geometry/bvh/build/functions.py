"""The machine code of trees' construction, compiled once, as functions that Python can call.

They take addresses as integers, and let other threads of Python run while they work.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache

from djpt.geometry.bvh.build.build_functions import add_build_functions
from djpt.geometry.bvh.build.collapse_functions import add_plan, add_weigh
from djpt.geometry.bvh.build.fit_functions import add_fit_functions
from djpt.geometry.bvh.build.row_functions import add_row_functions
from djpt.jit.llvm.compiler import CompilationError, compiled
from djpt.jit.llvm.ir import Module
from djpt.jit.llvm.lanes import target

__all__ = ["Functions", "can_compile", "functions"]

CTYPES = {"p": ctypes.c_void_p, "i": ctypes.c_int64, "f": ctypes.c_float}

SIGNATURES = {
    "bounds": "piipp",
    "prepare": "piipp",
    "split": "ppppiii",
    "grow": "ppppiii",
    "weigh": "piif",
    "plan": "pippppp",
    "emit": "ppppppiii",
    "fit": "ppppppiiip",
    "take_corners": "piip",
    "invert": "piip",
    "write_rows": "piipppi",
}
"""The parameters of the functions: pointers, integers and floats. All results are integers."""


PARTS: tuple[tuple[Callable[[Module], None], ...], ...] = (
    (add_build_functions,),
    (add_weigh, add_plan, add_fit_functions, add_row_functions),
)
"""The functions that fill each module; the modules take about the same time to compile."""

NAMES = (
    ("bounds", "prepare", "split", "grow"),
    ("weigh", "plan", "emit", "fit", "take_corners", "invert", "write_rows"),
)
"""The functions of each module."""


@dataclass
class Functions:
    """The functions, see the modules that define them."""

    bounds: Callable[..., int]
    prepare: Callable[..., int]
    split: Callable[..., int]
    grow: Callable[..., int]
    weigh: Callable[..., int]
    plan: Callable[..., int]
    emit: Callable[..., int]
    fit: Callable[..., int]
    take_corners: Callable[..., int]
    invert: Callable[..., int]
    write_rows: Callable[..., int]


@cache
def functions() -> Functions:
    """The functions, compiled at the first call, on two threads."""
    modules = []
    for part in PARTS:
        module = Module()
        for add in part:
            add(module)
        modules.append(module.text())
    target()  # which other threads may not be able to ask for
    with ThreadPoolExecutor(len(modules)) as team:
        addresses = {name: at for found in team.map(compiled, modules, NAMES) for name, at in found.items()}
    return Functions(
        **{
            name: ctypes.CFUNCTYPE(ctypes.c_int64, *(CTYPES[letter] for letter in letters))(addresses[name])
            for name, letters in SIGNATURES.items()
        }
    )


@cache
def can_compile() -> bool:
    """Whether the functions can be compiled on this machine: LLVM, or Dr.Jit's description of it, may be missing."""
    try:
        functions()
    except (CompilationError, OSError, AttributeError):
        return False
    return True
