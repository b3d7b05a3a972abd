"""The functions of Dr.Jit's core library that djpt binds by their mangled names.

The wheels of Dr.Jit 1.5 export them, but they are undocumented, so another version may lack any of them. Whoever asks
for one therefore has a slower way without it: see `djpt.jit.llvm.calls`, `djpt.jit.llvm.masks` and
`djpt.jit.llvm.lanes`. `missing` tells what a version lacks.
"""

from __future__ import annotations

import ctypes
import sys
from ctypes import POINTER, c_char_p, c_int, c_size_t, c_uint32, c_void_p
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import drjit as dr

__all__ = ["FUNCTIONS", "function", "missing"]


class Signature(NamedTuple):
    """The symbol of a function, and its types; variables of Dr.Jit are passed by their 32-bit indices."""

    symbol: str
    result: Any
    arguments: tuple[Any, ...] = ()


BACKEND, VARIABLE, VARIABLES = c_int, c_uint32, POINTER(c_uint32)

FUNCTIONS = {
    # Lanes: what kernels are compiled for, and in which portions threads take them.
    "vector_width": Signature("_Z21jit_llvm_vector_widthv", c_uint32),
    "block_size": Signature("_Z19jit_llvm_block_sizev", c_uint32),
    "set_block_size": Signature("_Z23jit_llvm_set_block_sizej", None, (c_uint32,)),
    "target_cpu": Signature("_Z19jit_llvm_target_cpuv", c_char_p),
    "target_features": Signature("_Z24jit_llvm_target_featuresv", c_char_p),
    "set_target": Signature("_Z19jit_llvm_set_targetPKcS0_j", None, (c_char_p, c_char_p, c_uint32)),
    # The mask of memory operations in symbolic loops.
    "mask_push": Signature("_Z17jit_var_mask_push10JitBackendj", None, (BACKEND, VARIABLE)),
    "mask_pop": Signature("_Z16jit_var_mask_pop10JitBackend", None, (BACKEND,)),
    "mask_default": Signature("_Z20jit_var_mask_default10JitBackendm", VARIABLE, (BACKEND, c_size_t)),
    # Calls of compiled functions, made for Embree's rays.
    "ray_trace": Signature("_Z18jit_llvm_ray_tracejjiPKjPj", None, (VARIABLE, VARIABLE, c_int, VARIABLES, VARIABLES)),
    "pointer": Signature("_Z15jit_var_pointer10JitBackendPKvji", VARIABLE, (BACKEND, c_void_p, VARIABLE, c_int)),
    "data": Signature("_Z12jit_var_datajPPv", VARIABLE, (VARIABLE, POINTER(c_void_p))),
    "release": Signature("_Z20jit_var_dec_ref_implj", None, (VARIABLE,)),
}
"""The functions by the names that djpt gives them."""


@cache
def library() -> ctypes.PyDLL:
    """Dr.Jit's core library, which the running process has loaded, where the wheels put it.

    Its functions are called with the interpreter's lock held: they use Dr.Jit's state of the thread.

    Raises:
        OSError: It isn't there.
    """
    suffix = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")
    prefix = "" if sys.platform == "win32" else "lib"
    return ctypes.PyDLL(str(Path(dr.__file__).parent / f"{prefix}drjit-core{suffix}"))


@cache
def function(name: str) -> Any:
    """One of `FUNCTIONS`, to be called with numbers.

    Raises:
        AttributeError: This version of Dr.Jit lacks it.
        OSError: The library isn't where the wheels put it.
    """
    signature = FUNCTIONS[name]
    found = library()[signature.symbol]
    found.restype, found.argtypes = signature.result, signature.arguments
    return found


def missing(*names: str) -> list[str]:
    """The `names`, by default all `FUNCTIONS`, that this version of Dr.Jit lacks."""

    def is_missing(name: str) -> bool:
        try:
            function(name)
        except (AttributeError, OSError):
            return True
        return False

    return [name for name in names or FUNCTIONS if is_missing(name)]
