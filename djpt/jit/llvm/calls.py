"""Calls of compiled functions from kernels.

Dr.Jit's kernels can call a function with the interface of Embree's `rtcIntersect`; Mitsuba uses this for
Embree. Two functions of Dr.Jit's core make such calls. They are exported but undocumented, so whoever relies on a
compiled function proves it first, with inputs of known results.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import numpy as np

from djpt.errors import DjptError
from djpt.jit.frozen import SHARED
from djpt.jit.kernels import may_wait
from djpt.jit.llvm.drjit_internals import function
from djpt.jit.llvm.lanes import lane_count
from djpt.jit.types import Float, UInt32

__all__ = ["WIDTHS", "CallError", "Code", "call", "reason_against"]

INPUTS, OUTPUTS = 14, 8

WIDTHS = (4, 8, 16)
"""The lanes of packets that functions are called with: for a single one the interface is another."""


class CallError(RuntimeError):
    """Dr.Jit's core lacks the functions by which kernels make calls."""


@dataclass
class Code:
    """A compiled function, in a form that kernels can refer to."""

    memory: UInt32
    """An array that begins at the function's address."""

    @staticmethod
    @cache
    def at(address: int) -> Code:
        """The function at an address, the same object at each call.

        Two arrays of the same memory become one where Dr.Jit repeats a frozen function, which it then records anew.

        Raises:
            CallError: Dr.Jit copies the code, though it is to share the memory.
        """
        word = UInt32(np.ctypeslib.as_array((ctypes.c_uint32 * 1).from_address(address)))
        if address_of(word) != address:
            raise CallError("Dr.Jit doesn't share the memory of functions")
        SHARED.append(word)
        return Code(word)


def pointer_to(array: UInt32 | Float) -> int:
    """A variable that holds the address of an array's memory and keeps it alive."""
    return int(bound("pointer")(dr.JitBackend.LLVM.value, address_of(array), array.index, 0))


def address_of(array: UInt32 | Float) -> int:
    """The address of an array's memory; the array is evaluated if need be."""
    address = ctypes.c_void_p()
    bound("release")(bound("data")(array.index, ctypes.byref(address)))
    return address.value or 0


def bound(name: str) -> Any:
    """A function of Dr.Jit's core.

    Raises:
        CallError: This version of Dr.Jit lacks it.
    """
    try:
        return function(name)
    except (OSError, AttributeError) as error:
        raise CallError(f"this version of Dr.Jit has no calls of functions: {error}") from None


def call(
    code: Code, memory: UInt32 | Float, inputs: Sequence[Any], outputs: list[Any], any_hit: bool = False
) -> list[Any]:
    """Call a function for every packet of lanes.

    Args:
        code: The function.
        memory: What its second parameter, a pointer, leads to.
        inputs: What Embree would get: whether rays are coherent and which lanes are active (Bool); origin, least
            distance, direction, time, and greatest distance (9 Float); mask, number, and flags (UInt32).
        outputs: Arrays of the results' types.
        any_hit: Whether there is one result alone: where the greatest distance has become negative.
    """
    pointers = [pointer_to(array) for array in (code.memory, memory)]
    made = (ctypes.c_uint32 * OUTPUTS)()
    bound("ray_trace")(*pointers, int(any_hit), (ctypes.c_uint32 * INPUTS)(*(x.index for x in inputs)), made)
    results: Any = dr.detail.update_indices(outputs, list(made)[: len(outputs)])
    for index in (*made, *pointers):
        if index:
            bound("release")(index)
    return list(results)


def reason_against(proved: Callable[[], bool], otherwise: str) -> str | None:
    """The reason against calls on this machine; None if `proved`, which makes some, gets the results that are known.

    `otherwise` is the reason if it gets others.
    """
    if dr.backend_v(Float) != dr.JitBackend.LLVM:
        return "they are for processors, not for CUDA"
    try:
        if lane_count() not in WIDTHS:
            return f"packets have {lane_count()} lanes"
        with may_wait():
            return None if proved() else otherwise
    except (CallError, DjptError, OSError, AttributeError) as error:
        return str(error)
