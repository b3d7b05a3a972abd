"""Functions of `djpt.jit.llvm.ir` values, under the names that they have in Dr.Jit.

A formula that is written with such a namespace serves both: Dr.Jit's kernels, and functions that LLVM
compiles from IR.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce

from djpt.jit.llvm.ir import I1, I32, Function, Operand, Type, Value

__all__ = [
    "abs",
    "across_lanes",
    "all_of",
    "any_of",
    "bit_count",
    "bit_length",
    "copysign",
    "fma",
    "gather",
    "lowest_bit",
    "maximum",
    "minimum",
    "rcp",
    "select",
    "smallest",
    "sqrt",
]


def fma(a: Operand, b: Operand, c: Operand) -> Value:
    """a b + c, rounded once."""
    values = [x for x in (a, b, c) if isinstance(x, Value)]
    widest = max(values, key=lambda x: x.type.lanes)
    arguments = [widest.function.like(widest, x) for x in (a, b, c)]
    return widest.function.intrinsic("fma", arguments, widest.type)


def rcp(x: Value) -> Value:
    """1 / x."""
    return 1.0 / x


def sqrt(x: Value) -> Value:
    """The square root."""
    return x.function.intrinsic("sqrt", [x], x.type)


def abs(x: Value) -> Value:
    """The absolute value."""
    return x.function.intrinsic("fabs", [x], x.type)


def copysign(x: Operand, sign: Value) -> Value:
    """`x` with the sign of another number."""
    return sign.function.intrinsic("copysign", [sign.function.like(sign, x), sign], sign.type)


def select(condition: Value, a: Operand, b: Operand) -> Value:
    """`a` where a condition holds, else `b`."""
    x, y = condition.function.matched(a, b)
    lanes = condition.type.lanes
    if lanes and not x.type.lanes:
        x, y = x.spread(lanes), y.spread(lanes)
    return condition.function.emit(f"select {condition}, {x}, {y}", x.type)


def minimum(a: Operand, b: Operand) -> Value:
    """The smaller of two numbers; `b` if either is NaN."""
    x, y = _function(a, b).matched(a, b)
    return select(x < y, x, y)


def maximum(a: Operand, b: Operand) -> Value:
    """The larger of two numbers; `b` if either is NaN."""
    x, y = _function(a, b).matched(a, b)
    return select(x > y, x, y)


def smallest(values: Sequence[Value]) -> Value:
    """The smallest of several numbers."""
    return reduce(minimum, values)


def across_lanes(x: Value, choose: Callable[[Value, Value], Value]) -> Value:
    """`minimum` or `maximum` of all lanes, in all lanes; their number is a power of two."""
    step = x.type.lanes // 2
    while step:
        x = choose(x, x.shuffled([k ^ step for k in range(x.type.lanes)]))
        step //= 2
    return x


def any_of(mask: Value) -> Value:
    """True if a mask is set in any lane."""
    return mask.bits_as(Type("i", mask.type.lanes)) != 0


def all_of(conditions: Sequence[Value]) -> Value:
    """The mask of lanes on which all conditions hold."""
    return reduce(lambda a, b: a & b, conditions)


def lowest_bit(bits: Value) -> Value:
    """The number of the lowest bit that is set; unspecified if none is."""
    function = bits.function
    return function.intrinsic("cttz", [bits, function.constant(I1, 1)], bits.type)


def bit_count(x: Value) -> Value:
    """The number of bits that are set."""
    return x.function.intrinsic("ctpop", [x], x.type)


def bit_length(x: Value) -> Value:
    """The number of bits that an integer needs, 0 for 0."""
    function = x.function
    return x.type.bits - function.intrinsic("ctlz", [x, function.constant(I1, 0)], x.type)


def gather(addresses: Value, mask: Value, other: Value) -> Value:
    """Read one lane from each address where a mask is set; lanes of `other` elsewhere."""
    function, type = addresses.function, other.type
    align = function.constant(I32, type.element.bits // 8)
    suffix = f"{type.suffix}.v{type.lanes}p0"
    return function.intrinsic("masked.gather", [addresses, align, mask, other], type, suffix)


def _function(a: Operand, b: Operand) -> Function:
    value = a if isinstance(a, Value) else b
    assert isinstance(value, Value)
    return value.function
