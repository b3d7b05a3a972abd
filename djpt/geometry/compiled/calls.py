"""Calls of compiled functions from kernels.

Dr.Jit's kernels can call a function with the interface of Embree's `rtcIntersect`; Mitsuba uses this for
Embree. Two functions of Dr.Jit's core make such calls. They are exported but undocumented, so
`djpt.geometry.compiled.engine` proves them with rays of known results before they are relied on.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import numpy as np

from djpt.llvm.lanes import core_path
from djpt.types import Bool, Float, Point3f, UInt32, Vector3f

__all__ = ["CallError", "Code", "Met", "call_any", "call_closest"]

INPUTS, OUTPUTS = 14, 8


class CallError(RuntimeError):
    """Dr.Jit's core lacks the functions by which kernels make calls."""


@dataclass
class Code:
    """A compiled function, in a form that kernels can refer to."""

    memory: UInt32
    """An array that begins at the function's address."""

    @staticmethod
    def at(address: int) -> Code:
        """The function at an address.

        Raises:
            CallError: Dr.Jit copies the code, though it is to share the memory.
        """
        word = UInt32(np.ctypeslib.as_array((ctypes.c_uint32 * 1).from_address(address)))
        if core().address_of(word) != address:
            raise CallError("Dr.Jit doesn't share the memory of functions")
        return Code(word)


@dataclass
class Met:
    """The results of a search."""

    hit: Bool
    t: Float
    """The distance; infinity on a miss."""
    b1: Float
    b2: Float
    record: UInt32
    inside: UInt32
    """The record of the instance that the hit belongs to, 0 if none."""


class Core:
    """The functions of Dr.Jit's core that make calls."""

    def __init__(self) -> None:
        try:
            # With the interpreter's lock held: these functions use Dr.Jit's state of the thread.
            library = ctypes.PyDLL(core_path())
            self.ray_trace = library["_Z18jit_llvm_ray_tracejjiPKjPj"]
            self.pointer = library["_Z15jit_var_pointer10JitBackendPKvji"]
            self.data = library["_Z12jit_var_datajPPv"]
            self.release = library["_Z20jit_var_dec_ref_implj"]
        except (OSError, AttributeError) as error:
            raise CallError(f"this version of Dr.Jit has no calls of functions: {error}") from None
        word, words = ctypes.c_uint32, ctypes.POINTER(ctypes.c_uint32)
        self.ray_trace.argtypes, self.ray_trace.restype = [word, word, ctypes.c_int, words, words], None
        self.pointer.argtypes = [ctypes.c_int, ctypes.c_void_p, word, ctypes.c_int]
        self.pointer.restype = word
        self.data.argtypes, self.data.restype = [word, ctypes.POINTER(ctypes.c_void_p)], word
        self.release.argtypes, self.release.restype = [word], None

    def trace(self, code: Code, scene: UInt32, inputs: Sequence[Any], outputs: list[Any], any_hit: bool) -> list[Any]:
        """Call a function with `inputs`; the results are arrays like `outputs`."""
        pointers = [self.pointer_to(array) for array in (code.memory, scene)]
        made = (ctypes.c_uint32 * OUTPUTS)()
        self.ray_trace(*pointers, int(any_hit), (ctypes.c_uint32 * INPUTS)(*(x.index for x in inputs)), made)
        results: Any = dr.detail.update_indices(outputs, list(made)[: len(outputs)])
        for index in (*made, *pointers):
            if index:
                self.release(index)
        return list(results)

    def pointer_to(self, array: UInt32) -> int:
        """A variable that holds the address of an array's memory and keeps it alive."""
        return int(self.pointer(dr.JitBackend.LLVM.value, self.address_of(array), array.index, 0))

    def address_of(self, array: UInt32) -> int:
        """The address of an array's memory; the array is evaluated if need be."""
        address = ctypes.c_void_p()
        self.release(self.data(array.index, ctypes.byref(address)))
        return address.value or 0


@cache
def core() -> Core:
    """Dr.Jit's core, opened at the first call."""
    return Core()


def call_closest(code: Code, scene: UInt32, o: Point3f, d: Vector3f, maxt: Float, active: Bool, flags: UInt32) -> Met:
    """Find the first hit with 0 < t < maxt of each active lane's ray."""
    outputs: list[Any] = [Bool(False), Float(0), Float(0), Float(0), UInt32(0), UInt32(0)]
    return Met(*core().trace(code, scene, arguments(o, d, maxt, active, flags), outputs, False))


def call_any(code: Code, scene: UInt32, o: Point3f, d: Vector3f, maxt: Float, active: Bool, flags: UInt32) -> Bool:
    """Whether each active lane's ray has a hit with 0 < t < maxt."""
    return Bool(core().trace(code, scene, arguments(o, d, maxt, active, flags), [Bool(False)], True)[0])


def arguments(o: Point3f, d: Vector3f, maxt: Float, active: Bool, flags: UInt32) -> list[Float | UInt32 | Bool]:
    """The inputs of a call, in Embree's order."""
    # A negative end would mean "blocked" when it comes back.
    o, d, maxt = dr.detach(o), dr.detach(d), dr.select(maxt > 0, dr.detach(maxt), 0)
    # A ray with NaN would meet all boxes, also those of missing children.
    reach = dr.abs(o.x) + dr.abs(o.y) + dr.abs(o.z)
    active = active & (reach < 1e18) & dr.isfinite(d.x + d.y + d.z)
    zero, unused = Float(0), UInt32(0)
    return [Bool(False), active, o.x, o.y, o.z, zero, d.x, d.y, d.z, zero, maxt, flags, unused, unused]
