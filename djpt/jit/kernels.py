"""Dr.Jit idioms of kernels: reproducible traces, inputs, loop state, minimum and maximum, memory.

A kernel is compiled once for each program text. Numbers that may change between renders must
therefore be *opaque*: inputs of the kernel, not literals in its text.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace
from typing import Any, Protocol, TypeVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.errors import ArgumentError
from djpt.jit.daemons import note_thread
from djpt.jit.frozen import hold_garbage, recording
from djpt.jit.types import Bool, Float, UInt32, Vector3f

__all__ = [
    "KERNELS",
    "Arithmetic",
    "aligned",
    "aligned_floats",
    "as_float",
    "as_vector",
    "begin_trace",
    "computed_where",
    "float_in",
    "if_stmt",
    "lerp",
    "loop_traced_once",
    "mapped",
    "maximum",
    "may_wait",
    "minimum",
    "numbers_of",
    "one_by_one",
    "opaque",
    "own_copy",
    "own_floats",
    "power_of_two",
    "shared",
    "while_loop",
    "wide",
]

T = TypeVar("T")


# ---- traces ----------------------------------------------------------------------------------


def begin_trace() -> None:
    """Trace what follows independently of what was traced before.

    Dr.Jit merges equal subexpressions, literals included, within a scope. Without a scope of
    its own, a kernel would share literals with whatever happens to be alive, and the same
    render would compile twice: once with and once without them.
    """
    note_thread()
    hold_garbage()
    dr.detail.new_scope(dr.backend_v(Float))


# ---- inputs ----------------------------------------------------------------------------------


def may_wait() -> Any:
    """A context in which the host may wait for kernels, although `dr.JitFlag.ForbidSynchronization` is set."""
    return dr.scoped_set_flag(dr.JitFlag.ForbidSynchronization, False)


def opaque(value: T) -> T:
    """A detached copy of the Dr.Jit array `value` that kernels take as an input, not as a literal."""
    copy = type(value)(dr.detach(value))  # type: ignore[call-arg]
    dr.make_opaque(copy)
    return copy


def as_float(value: float) -> Float:
    """An opaque `Float` of width 1."""
    return dr.opaque(Float, float(value))


def as_vector(v: NDArray[np.floating[Any]]) -> Vector3f:
    """An opaque vector of width 1 from three numbers."""
    return Vector3f(*(as_float(float(x)) for x in v))


# ---- loops and branches ----------------------------------------------------------------------
#
# Dr.Jit can also evaluate loops turn by turn, if its flags say so: for loops that scripts debug. Those of
# djpt keep stacks and sums in local memory, which aborts the process then, so they don't ask the flags.


def while_loop(state: Any, condition: Any, body: Any, **options: Any) -> Any:
    """A loop of Dr.Jit that becomes part of a kernel, whatever the flags say. Arguments as for `dr.while_loop`."""
    return dr.while_loop(state, condition, body, mode="symbolic", **options)


def if_stmt(arguments: Any, condition: Any, true_fn: Any, false_fn: Any, **options: Any) -> Any:
    """A branch of Dr.Jit that becomes part of a kernel, whatever the flags say. Arguments as for `dr.if_stmt`."""
    return dr.if_stmt(arguments, condition, true_fn, false_fn, mode="symbolic", **options)


def computed_where(condition: Bool, work: Callable[[], T], label: str) -> T:
    """What `work` returns where a condition holds, and zeros elsewhere: packets of lanes skip it if none needs it.

    The result is a record, list or tuple of arrays. Random numbers must be drawn before, and records that `work` reads
    are to be copies (`Record.replaced`): a field that is first read in a branch doesn't exist outside of it.
    """
    found: list[Any] = []

    def wanted(_: Bool) -> Any:
        found.append(work())
        return (found[0],)

    def unwanted(_: Bool) -> Any:
        # Dr.Jit doesn't ask for the other branch where it knows that the condition never holds.
        like = found[0] if found else work()
        return (mapped(like, lambda numbers: dr.zeros(type(numbers))),)

    (result,) = if_stmt((Bool(True),), condition, wanted, unwanted, label=label)
    found.clear()
    return result


# ---- loop state ------------------------------------------------------------------------------


def mapped(record: Any, change: Callable[[Any], Any]) -> Any:
    """A copy of a record, list, tuple or vector, with `change` applied to the arrays of numbers that it consists of.

    What holds no arrays stays as it is.
    """
    if isinstance(record, (list, tuple)):
        return type(record)(mapped(entry, change) for entry in record)
    if dr.is_array_v(record):
        return type(record)(*(mapped(c, change) for c in record)) if dr.depth_v(record) > 1 else change(record)
    if is_dataclass(record) and not isinstance(record, type):
        return replace(record, **{f.name: mapped(getattr(record, f.name), change) for f in fields(record)})
    if not hasattr(record, "DRJIT_STRUCT"):
        return record
    copy = type(record)()
    for name in type(record).DRJIT_STRUCT:
        setattr(copy, name, mapped(getattr(record, name), change))
    return copy


def numbers_of(record: Any) -> list[Any]:
    """The arrays of numbers that a record, list, tuple or vector consists of, in the order of `mapped`."""
    if isinstance(record, (list, tuple)):
        return [number for entry in record for number in numbers_of(entry)]
    if dr.is_array_v(record):
        return [number for entry in record for number in numbers_of(entry)] if dr.depth_v(record) > 1 else [record]
    if is_dataclass(record) and not isinstance(record, type):
        names: Any = (f.name for f in fields(record))
    else:
        names = getattr(record, "DRJIT_STRUCT", ())
    return [number for name in names for number in numbers_of(getattr(record, name))]


def power_of_two(count: int) -> int:
    """The smallest power of two that isn't less: a size for arrays whose size is part of a kernel."""
    return 1 << max(count - 1, 0).bit_length()


def wide(record: Any, lanes: int) -> Any:
    """A record, list or tuple of arrays in which all arrays have full width.

    Loop state must not start as variables of width 1: the loop would be compiled for them and again at full
    width. None and what isn't a Dr.Jit array stay as they are.
    """

    def widened(numbers: Any) -> Any:
        return (
            numbers | dr.full(Bool, False, lanes) if dr.is_mask_v(numbers) else numbers + dr.zeros(type(numbers), lanes)
        )

    return mapped(record, widened)


def loop_traced_once(start: T, condition: Callable[[T], Bool], body: Callable[[T], tuple[T]], label: str) -> tuple[T]:
    """Run a loop over one record, whose body is traced once.

    Dr.Jit traces a body again when it finds that some of the state stays as it is, to leave it out of the state. LLVM
    finds that, too, and tracing is half of the time of a small picture.
    """
    optimise = dr.JitFlag.OptimizeLoops

    def traced(state: T) -> tuple[T]:
        # Loops within this one are small, and gain from being traced again.
        with dr.scoped_set_flag(optimise, True):
            return body(state)

    with dr.scoped_set_flag(optimise, False):
        result: tuple[T] = while_loop((start,), condition, traced, label=label)
    return result


# ---- minimum, maximum, interpolation ---------------------------------------------------------
#
# `dr.minimum` and `dr.maximum` propagate NaNs and take three instructions for it. In the inner
# loop of a path tracer that costs 15 % (docs/performance.md). These take two, for operands that
# can't be NaN or where a NaN does no harm.


def minimum(a: Float, b: Float | float) -> Float:
    """The smaller of two numbers; `b` if either is NaN."""
    return dr.select(a < b, a, b)


def maximum(a: Float, b: Float | float) -> Float:
    """The larger of two numbers; `b` if either is NaN."""
    return dr.select(a > b, a, b)


def lerp(a: Any, b: Any, t: Float) -> Any:
    """The linear interpolation from `a` (t = 0) to `b` (t = 1)."""
    return dr.fma(b - a, t, a)


# ---- memory ----------------------------------------------------------------------------------
#
# Dr.Jit shares NumPy's memory, and whether that is aligned is part of a kernel: the same code would
# be compiled several times. Also, only aligned memory of Dr.Jit's own has packet loads.


def aligned(shape: tuple[int, ...]) -> NDArray[np.uint32]:
    """Zeros in NumPy's memory, which starts at a multiple of 64 bytes."""
    count = math.prod(shape)
    room = np.zeros(count + 16, np.uint32)
    first = (-room.ctypes.data % 64) // 4
    return room[first : first + count].reshape(shape)


def aligned_floats(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Zeros in aligned memory, as `aligned`, of floats."""
    return aligned(shape).view(np.float32)


def shared(values: NDArray[np.uint32]) -> UInt32:
    """A copy of an array in aligned memory, for kernels that gather single words."""
    copy = aligned(values.shape)
    copy[...] = values
    return UInt32(copy.ravel())


def own_copy(values: NDArray[np.uint32] | NDArray[np.float32]) -> UInt32:
    """The bits of an array in memory of Dr.Jit's own, for kernels that gather packets."""
    return own_array(UInt32, np.ascontiguousarray(values).view(np.uint32).ravel())


def own_floats(values: NDArray[np.float32]) -> Float:
    """A copy of an array of floats in memory of Dr.Jit's own."""
    return own_array(Float, np.ascontiguousarray(values, np.float32).ravel())


MAX_RECORDED = 4096
"""The longest table that is made number by number."""


def own_array(kind: type[T], values: NDArray[Any]) -> T:
    """Copy numbers to an array of Dr.Jit, in its own memory."""
    if not len(values):
        return kind()
    if recording():
        if len(values) > MAX_RECORDED:
            raise ArgumentError(
                f"a frozen function can't make a table of {len(values)} numbers: create it before the call"
            )
        return one_by_one([dr.opaque(kind, number) for number in values.tolist()])  # type: ignore[arg-type]
    if dr.backend_v(kind) != dr.JitBackend.LLVM:
        # To GPUs everything is copied.
        return kind(values)  # type: ignore[call-arg]
    memory = dr.empty(kind, len(values))
    # The host sees the same memory, once no kernel uses what stood there before.
    with may_wait():
        np.asarray(memory)[:] = values
    return memory


def one_by_one(numbers: Sequence[Any]) -> Any:
    """The array of some arrays of width 1, in a way that `dr.freeze` can record."""
    memory = dr.opaque(type(numbers[0]), 0, len(numbers))
    for i, number in enumerate(numbers):
        dr.scatter(memory, opaque(number), dr.opaque(UInt32, i))
        dr.eval(memory)
    return memory


def float_in(word: UInt32) -> Float:
    """The float whose bits a word holds."""
    number: Any = dr.reinterpret_array(Float, word)
    return number


class Arithmetic(Protocol):
    """Functions of numbers: of Dr.Jit's, or of those of `djpt.jit.llvm.arithmetic`.

    A formula that takes its functions from a namespace can be written once: Dr.Jit traces it with `KERNELS`, and
    `djpt.jit.llvm.arithmetic` has functions of the same names that write IR.
    """

    fma: Callable[..., Any]
    rcp: Callable[..., Any]
    sqrt: Callable[..., Any]
    abs: Callable[..., Any]
    select: Callable[..., Any]
    minimum: Callable[..., Any]
    maximum: Callable[..., Any]


KERNELS: Any = SimpleNamespace(
    fma=dr.fma, rcp=dr.rcp, sqrt=dr.sqrt, abs=dr.abs, select=dr.select, minimum=minimum, maximum=maximum
)
"""The arithmetic of Dr.Jit."""
