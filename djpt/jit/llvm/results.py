"""Results that are read while kernels run which were launched later."""

from __future__ import annotations

import ctypes
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.jit.llvm.calls import CallError, address_of
from djpt.jit.types import Event, Float

__all__ = ["Results"]

Floats = npt.NDArray[np.float32]


class Results:
    """The arrays that the kernels compute which have been launched until now.

    ``array.numpy()`` waits for all kernels, also for those that were launched in the meantime, and leaves the processor
    idle until Python has launched others.
    """

    def __init__(self) -> None:
        self._computed = Event()
        self._computed.record()

    def numpy(self, array: Float) -> Floats:
        """The numbers of one of the arrays, in its memory; waits for the kernels of these results alone.

        On GPUs, and where an array isn't in memory yet, all kernels are waited for.
        """
        if dr.backend_v(Float) != dr.JitBackend.LLVM or array.state != dr.VarState.Evaluated:
            return array.numpy()
        try:
            address = address_of(array)
        except CallError:
            return array.numpy()
        self._computed.wait()
        memory: Any = (ctypes.c_float * dr.width(array)).from_address(address)
        memory.owner = array
        return np.ctypeslib.as_array(memory)
