"""Compiled functions that work on arrays of NumPy, for loops that take NumPy many passes."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from djpt.jit.llvm.ir import Module

__all__ = ["HostFunctions", "Run", "host_functions"]

Run = Callable[..., int]
"""Calls a function by its name, with arrays, which become addresses, and integers; gives its result."""


class HostFunctions:
    """Functions that are compiled once there is enough for them to do."""

    def __init__(self, add: Callable[[Module], None], parameters: Mapping[str, int], small: int, few: int) -> None:
        """`add` and `parameters` are for `host_functions`; `few` jobs of a size below `small` aren't worth it."""
        self._add, self._parameters, self.small, self.few = add, parameters, small, few
        self._run: Run | None = None
        self._asked, self._small_jobs = False, 0

    def for_size(self, size: int) -> Run | None:
        """The engine for the functions, for a job of some size; None if it is better done without, or has to be."""
        if size < self.small and self._small_jobs < self.few:
            self._small_jobs += 1
            return None
        if not self._asked:
            self._asked, self._run = True, host_functions(self._add, self._parameters)
        return self._run


def host_functions(add: Callable[[Module], None], parameters: Mapping[str, int]) -> Run | None:
    """Compile the functions that `add` adds to a module; None where nothing can be compiled.

    Args:
        add: The functions give integers of 64 bits; their parameters are addresses, or such integers.
        parameters: The names of the functions, and how many parameters each has.
    """
    from djpt.jit.llvm.compiler import CompilationError, compiled  # most scenes compile nothing of this kind

    module = Module()
    add(module)
    try:
        addresses = compiled(module.text(), tuple(parameters))
    except (CompilationError, OSError, AttributeError):
        return None
    code = {
        name: ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_int64] * count)(addresses[name])
        for name, count in parameters.items()
    }

    def run(name: str, *arguments: NDArray[np.generic] | int) -> int:
        # Arrays must be contiguous and of the type that the function reads.
        return code[name](*[a if type(a) is int else a.__array_interface__["data"][0] for a in arguments])  # type: ignore[union-attr]

    return run
