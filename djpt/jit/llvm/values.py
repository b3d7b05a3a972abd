"""The types, values and variables of `djpt.jit.llvm.ir`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from djpt.errors import DjptError

if TYPE_CHECKING:
    from djpt.jit.llvm.ir import Function

__all__ = [
    "F32",
    "F64",
    "I1",
    "I8",
    "I16",
    "I32",
    "I64",
    "PTR",
    "Array",
    "Operand",
    "Type",
    "Value",
    "Variable",
    "vector",
]


@dataclass(frozen=True)
class Type:
    """A type of LLVM: `kind` i, f or ptr, with `bits`, in `lanes` copies (0: a scalar)."""

    kind: str
    bits: int
    lanes: int = 0

    def __str__(self) -> str:
        return type_text(self.kind, self.bits, self.lanes)

    @property
    def suffix(self) -> str:
        """The type in the names of intrinsic functions, such as v8f32."""
        return (f"v{self.lanes}" if self.lanes else "") + f"{self.kind}{self.bits}"

    @property
    def size(self) -> int:
        """Bytes in memory."""
        return max(self.lanes, 1) * self.bits // 8

    @property
    def element(self) -> Type:
        """The type of one lane."""
        return Type(self.kind, self.bits)


@cache
def type_text(kind: str, bits: int, lanes: int) -> str:
    """A type as LLVM writes it; kept, because each instruction names some."""
    scalar = {"i": f"i{bits}", "f": "float" if bits == 32 else "double", "ptr": "ptr"}[kind]
    return f"<{lanes} x {scalar}>" if lanes else scalar


I1, I8, I16, I32, I64 = (Type("i", bits) for bits in (1, 8, 16, 32, 64))
F32, F64 = Type("f", 32), Type("f", 64)
PTR = Type("ptr", 64)


def vector(element: Type, lanes: int) -> Type:
    """The type of `lanes` elements side by side."""
    return Type(element.kind, element.bits, lanes)


OF_FLOATS = ("div",)
OF_INTEGERS = ("udiv", "urem", "and", "or", "xor", "shl", "lshr")
"""The operations that only floats, or only integers, have."""


class Value:
    """The result of an instruction, a parameter or a constant."""

    def __init__(self, function: Function, type: Type, text: str) -> None:
        """`text` is how instructions refer to it."""
        self.function, self.type, self.text = function, type, text

    def __str__(self) -> str:
        return f"{self.type} {self.text}"

    # ---- arithmetic --------------------------------------------------------------------

    def __add__(self, other: Operand) -> Value:
        return self._binary("add", other)

    def __sub__(self, other: Operand) -> Value:
        return self._binary("sub", other)

    def __rsub__(self, other: Operand) -> Value:
        return self.function.like(self, other) - self

    def __mul__(self, other: Operand) -> Value:
        return self._binary("mul", other)

    def __truediv__(self, other: Operand) -> Value:
        return self._binary("div", other)

    def __rtruediv__(self, other: Operand) -> Value:
        return self.function.like(self, other) / self

    def __floordiv__(self, other: Operand) -> Value:
        return self._binary("udiv", other)

    def __mod__(self, other: Operand) -> Value:
        return self._binary("urem", other)

    def __neg__(self) -> Value:
        return self.function.emit(f"fneg {self}", self.type) if self.type.kind == "f" else 0 - self

    def __and__(self, other: Operand) -> Value:
        return self._binary("and", other)

    def __or__(self, other: Operand) -> Value:
        return self._binary("or", other)

    def __xor__(self, other: Operand) -> Value:
        return self._binary("xor", other)

    def __invert__(self) -> Value:
        return self ^ ((1 << self.type.bits) - 1)

    def __lshift__(self, other: Operand) -> Value:
        return self._binary("shl", other)

    def __rshift__(self, other: Operand) -> Value:
        return self._binary("lshr", other)

    __radd__, __rmul__ = __add__, __mul__
    __rand__, __ror__, __rxor__ = __and__, __or__, __xor__

    # ---- comparison ----------------------------------------------------------------------

    def __lt__(self, other: Operand) -> Value:
        return self._compare("lt", other)

    def __le__(self, other: Operand) -> Value:
        return self._compare("le", other)

    def __gt__(self, other: Operand) -> Value:
        return self._compare("gt", other)

    def __ge__(self, other: Operand) -> Value:
        return self._compare("ge", other)

    def __eq__(self, other: Operand) -> Value:  # type: ignore[override]
        return self._compare("eq", other)

    def __ne__(self, other: Operand) -> Value:  # type: ignore[override]
        return self._compare("ne", other)

    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        raise TypeError("a value is known when the code runs, not while it is built: use when() or select()")

    # ---- other forms ---------------------------------------------------------------------

    def to(self, type: Type) -> Value:
        """The number in another type; integers are cut or filled with zeros.

        The result is unspecified for floats that are negative or too large for an integer.
        """
        source, target = self.type, Type(type.kind, type.bits, self.type.lanes)
        if source == target:
            return self
        if source.kind == "i" and target.kind == "i":
            operation = "trunc" if target.bits < source.bits else "zext"
        elif source.kind == "f" and target.kind == "f":
            operation = "fptrunc" if target.bits < source.bits else "fpext"
        else:
            operation = "uitofp" if source.kind == "i" else "fptoui"
        return self.function.emit(f"{operation} {self} to {target}", target)

    def whole(self, type: Type = I32) -> Value:
        """A float without its fraction as a signed integer: faster than `to`."""
        target = Type(type.kind, type.bits, self.type.lanes)
        return self.function.emit(f"fptosi {self} to {target}", target)

    def bits_as(self, type: Type) -> Value:
        """Reinterpret the bits as another type of the same size; a mask becomes an integer, lane 0 the lowest bit."""
        return self.function.emit(f"bitcast {self} to {type}", type)

    def spread(self, lanes: int) -> Value:
        """A vector with this value in all lanes."""
        type = vector(self.type, lanes)
        one = self.function.emit(f"insertelement {type} undef, {self}, i32 0", type)
        zero = f"<{lanes} x i32> zeroinitializer"
        return self.function.emit(f"shufflevector {one}, {type} undef, {zero}", type)

    def lane(self, index: int | Value) -> Value:
        """One lane of a vector."""
        at = f"i32 {index}" if isinstance(index, int) else str(index)
        return self.function.emit(f"extractelement {self}, {at}", self.type.element)

    def shuffled(self, lanes: Sequence[int], other: Value | None = None) -> Value:
        """A vector of the given lanes; lanes of `other` count on from those of this vector."""
        type = vector(self.type.element, len(lanes))
        second = f"{self.type} undef" if other is None else str(other)
        chosen = ", ".join(f"i32 {lane}" for lane in lanes)
        return self.function.emit(f"shufflevector {self}, {second}, <{len(lanes)} x i32> <{chosen}>", type)

    def at(self, offset: Operand) -> Value:
        """The address `offset` bytes further on; a vector of addresses for a vector of offsets."""
        # Narrower integers would be taken for signed ones.
        offset = offset.to(I64) if isinstance(offset, Value) else self.function.constant(I64, offset)
        type = Type(PTR.kind, PTR.bits, offset.type.lanes)
        return self.function.emit(f"getelementptr i8, {self}, {offset}", type)

    # ---- parts ---------------------------------------------------------------------------

    def _binary(self, operation: str, other: Operand) -> Value:
        a, b = self.function.matched(self, other)
        if a.type.kind == "ptr" or operation in (OF_INTEGERS if a.type.kind == "f" else OF_FLOATS):
            raise DjptError(f"no operation '{operation}' of {a.type}")
        if a.type.kind == "f":
            operation = f"f{operation}"
        return self.function.emit(f"{operation} {a}, {b.text}", a.type)

    def _compare(self, relation: str, other: Operand) -> Value:
        a, b = self.function.matched(self, other)
        if a.type.kind == "f":
            # Comparisons with NaN are false, except "not equal".
            operation = f"fcmp {'u' if relation == 'ne' else 'o'}{relation}"
        else:
            operation = f"icmp {relation if relation in ('eq', 'ne') else 'u' + relation}"
        return self.function.emit(f"{operation} {a}, {b.text}", Type("i", 1, a.type.lanes))


Operand = Value | float
"""The other operand of an operator: a value, or a Python number."""


class Variable:
    """A place for values of one type that change while the function runs."""

    def __init__(self, function: Function, type: Type) -> None:
        self._function, self.type = function, type
        self.address = function.reserve(type)

    @property
    def value(self) -> Value:
        """The present value; assign to change it."""
        return self._function.load(self.type, self.address)

    @value.setter
    def value(self, value: Operand) -> None:
        self._function.store(self._function.constant(self.type, value), self.address)


class Array:
    """A fixed number of values of one type on the stack of the running function, without initial values."""

    def __init__(self, function: Function, type: Type, count: int) -> None:
        self._function, self.type = function, type
        self.address = function.reserve(type, count)

    def place(self, index: Operand) -> Value:
        """The address of an element."""
        index = index.to(I64) if isinstance(index, Value) else self._function.constant(I64, index)
        return self._function.emit(f"getelementptr {self.type}, {self.address}, {index}", PTR)

    def __getitem__(self, index: Operand) -> Value:
        return self._function.load(self.type, self.place(index))

    def __setitem__(self, index: Operand, value: Operand) -> None:
        self._function.store(self._function.constant(self.type, value), self.place(index))

    def store(self, values: Value) -> None:
        """Write a vector over the first elements."""
        self._function.store(values, self.address)
