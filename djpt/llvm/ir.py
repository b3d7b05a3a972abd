"""A builder of LLVM IR: machine code written as Python, with operators and structured control flow.

Dr.Jit records what a kernel does for every lane. Some algorithms don't fit that form: a traversal that
tests eight boxes of one node at once, or the construction of a tree. They are written with this builder
and compiled by `djpt.llvm.compiler`::

    module = Module()
    with module.function("clamped_sum", [("data", PTR), ("count", I64)], F32) as f:
        data, count = f.parameters
        total = f.variable(F32, 0.0)
        with f.each(0, count) as i:
            total.value = minimum(total.value + f.load(F32, data.at(i * 4)), 100.0)
        f.give(total.value)

A `Value` is an instruction's result: immutable, with a type and operators. A `Variable` is a name for
values that change; LLVM turns variables into registers. Integers are unsigned. Python numbers become
constants of the other operand's type, and a scalar beside a vector is copied to all its lanes.

Floats are neither reordered nor fused: a product and a sum are two roundings, `fma` is one.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from djpt.errors import DjptError

__all__ = [
    "F32",
    "F64",
    "I1",
    "I8",
    "I32",
    "I64",
    "PTR",
    "Array",
    "Function",
    "Loop",
    "Module",
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
        scalar = {"i": f"i{self.bits}", "f": "float" if self.bits == 32 else "double", "ptr": "ptr"}[self.kind]
        return f"<{self.lanes} x {scalar}>" if self.lanes else scalar

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


I1, I8, I32, I64 = (Type("i", bits) for bits in (1, 8, 32, 64))
F32, F64 = Type("f", 32), Type("f", 64)
PTR = Type("ptr", 64)


def vector(element: Type, lanes: int) -> Type:
    """The type of `lanes` elements side by side."""
    return Type(element.kind, element.bits, lanes)


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
        """The number in another type; integers are cut or filled with zeros."""
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
        """A float without its fraction as an integer, up to the largest signed one: faster than `to`."""
        target = Type(type.kind, type.bits, self.type.lanes)
        return self.function.emit(f"fptosi {self} to {target}", target)

    def bits_as(self, type: Type) -> Value:
        """The same bits as another type of the same size; a mask becomes an integer, lane 0 the lowest bit."""
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
        offset = self.function.constant(I64, offset) if isinstance(offset, int) else offset
        type = Type(PTR.kind, PTR.bits, offset.type.lanes if isinstance(offset, Value) else 0)
        return self.function.emit(f"getelementptr i8, {self}, {offset}", type)

    # ---- parts ---------------------------------------------------------------------------

    def _binary(self, operation: str, other: Operand) -> Value:
        a, b = self.function.matched(self, other)
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
"""What operators take beside a value: another one, or a Python number."""


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
        index = self._function.constant(I64, index)
        return self._function.emit(f"getelementptr {self.type}, {self.address}, {index}", PTR)

    def __getitem__(self, index: Operand) -> Value:
        return self._function.load(self.type, self.place(index))

    def __setitem__(self, index: Operand, value: Operand) -> None:
        self._function.store(self._function.constant(self.type, value), self.place(index))

    def store(self, values: Value) -> None:
        """Write a vector over the first elements."""
        self._function.store(values, self.address)


class Loop:
    """A loop that is being built: where to jump to begin its next turn, and to leave it."""

    def __init__(self, function: Function, again: str, end: str) -> None:
        self._function, self._again, self._end = function, again, end

    def stop(self) -> None:
        """Leave the loop."""
        self._function.jump(self._end)

    def again(self) -> None:
        """Begin the next turn."""
        self._function.jump(self._again)

    def stop_if(self, condition: Value) -> None:
        """Leave the loop if a condition holds."""
        self._function.branch(condition, self._end)

    def again_if(self, condition: Value) -> None:
        """Begin the next turn if a condition holds."""
        self._function.branch(condition, self._again)


class Function:
    """A function that is being built. Made by `Module.function`."""

    def __init__(self, module: Module, parameters: Sequence[tuple[str, Type]], result: Type | None) -> None:
        self.module, self._result = module, result
        self._reserved: list[str] = []
        self._lines: list[str] = []
        self._count = 0
        self._open = True
        self.parameters = [Value(self, type, f"%{name}") for name, type in parameters]

    # ---- values ----------------------------------------------------------------------------

    def constant(self, type: Type, value: Operand) -> Value:
        """A number as a constant; a value stays itself, a scalar is spread if `type` is a vector."""
        if isinstance(value, Value):
            return value.spread(type.lanes) if type.lanes and not value.type.lanes else value
        if type.lanes:
            element = self.constant(type.element, value)
            return Value(self, type, "<" + ", ".join([str(element)] * type.lanes) + ">")
        if type.kind == "f":
            # LLVM writes floats as the bits of a double, which must be exactly representable.
            exact = struct.unpack("f", struct.pack("f", value))[0] if type.bits == 32 else value
            return Value(self, type, f"0x{struct.unpack('Q', struct.pack('d', exact))[0]:016X}")
        return Value(self, type, str(int(value) & ((1 << type.bits) - 1)))

    def like(self, value: Value, number: Operand) -> Value:
        """A number as a constant of a value's type."""
        return self.constant(value.type, number)

    def matched(self, a: Operand, b: Operand) -> tuple[Value, Value]:
        """Two operands as values of one type; at least one is a value."""
        if isinstance(a, Value) and isinstance(b, Value):
            type = a.type if a.type.lanes else b.type
        else:
            type = a.type if isinstance(a, Value) else b.type  # type: ignore[union-attr]
        first, second = self.constant(type, a), self.constant(type, b)
        if first.type != second.type:
            raise DjptError(f"operands of different types, {first.type} and {second.type}")
        return first, second

    def variable(self, type: Type, initial: Operand) -> Variable:
        """A new variable."""
        result = Variable(self, type)
        result.value = initial  # type: ignore[assignment]
        return result

    def array(self, type: Type, count: int) -> Array:
        """A new array on the stack."""
        return Array(self, type, count)

    # ---- memory and calls --------------------------------------------------------------------

    def load(self, type: Type, address: Value, align: int = 0) -> Value:
        """Read memory; `align`, in bytes, is that of the element unless a larger one is known."""
        return self.emit(f"load {type}, {address}, align {align or max(type.element.bits // 8, 1)}", type)

    def store(self, value: Value, address: Value, align: int = 0) -> None:
        """Write memory."""
        self._write(f"store {value}, {address}, align {align or max(value.type.element.bits // 8, 1)}")

    def prefetch(self, address: Value) -> None:
        """Ask for the cache line of an address, which will be read soon."""
        self.module.declare("declare void @llvm.prefetch.p0(ptr, i32, i32, i32)")
        # For reading, to be kept in all levels, data.
        self._write(f"call void @llvm.prefetch.p0({address}, i32 0, i32 3, i32 1)")

    def intrinsic(self, name: str, arguments: Sequence[Value], result: Type, suffix: str | None = None) -> Value:
        """Call a function that is built into LLVM, such as sqrt; its name ends in the type of the result."""
        full = f"llvm.{name}.{result.suffix if suffix is None else suffix}"
        self.module.declare(f"declare {result} @{full}({', '.join(str(a.type) for a in arguments)})")
        return self.emit(f"call {result} @{full}({', '.join(str(a) for a in arguments)})", result)

    def call(self, name: str, arguments: Sequence[Value], result: Type | None = None) -> Value | None:
        """Call a function of the module."""
        text = f"call {result or 'void'} @{name}({', '.join(str(a) for a in arguments)})"
        if result is None:
            self._write(text)
            return None
        return self.emit(text, result)

    def give(self, value: Operand | None = None) -> None:
        """Return from the function."""
        if self._result is None:
            self._close("ret void")
        else:
            assert value is not None
            self._close(f"ret {self.constant(self._result, value)}")

    # ---- control flow --------------------------------------------------------------------------

    @contextmanager
    def when(self, condition: Value) -> Iterator[None]:
        """Run what is built inside if a condition holds."""
        inside, after = self._label(), self._label()
        self._close(f"br {condition}, label %{inside}, label %{after}")
        self._begin(inside)
        yield
        self.jump(after)
        self._begin(after)

    @contextmanager
    def either(self, condition: Value) -> Iterator[Otherwise]:
        """Run one of two parts: what is built up to `otherwise()` if a condition holds, else what follows it."""
        inside, other, after = self._label(), self._label(), self._label()
        self._close(f"br {condition}, label %{inside}, label %{other}")
        self._begin(inside)
        branch = Otherwise(self, other, after)
        yield branch
        branch.finish()

    @contextmanager
    def loop(self) -> Iterator[Loop]:
        """Run what is built inside again and again, until it leaves the loop or the function."""
        top, end = self._label(), self._label()
        self.jump(top)
        self._begin(top)
        yield Loop(self, top, end)
        self.jump(top)
        self._begin(end)

    @contextmanager
    def each(self, first: Operand, end: Operand) -> Iterator[Value]:
        """Run what is built inside for every whole number from `first` up to, but without, `end`."""
        index = self.variable(I64, self.constant(I64, first))
        with self.loop() as turns:
            i = index.value
            turns.stop_if(i >= end)
            index.value = i + 1
            yield i

    @contextmanager
    def each_backwards(self, first: Operand, end: Operand) -> Iterator[Value]:
        """Run what is built inside for every whole number below `end` down to `first`."""
        index = self.variable(I64, self.constant(I64, end))
        with self.loop() as turns:
            turns.stop_if(index.value <= first)
            index.value = index.value - 1
            yield index.value

    # ---- text ------------------------------------------------------------------------------------

    def emit(self, text: str, type: Type) -> Value:
        """Add an instruction and return its result."""
        self._count += 1
        name = f"%v{self._count}"
        self._write(f"{name} = {text}")
        return Value(self, type, name)

    def reserve(self, type: Type, count: int = 1) -> Value:
        """Room on the stack for `count` values, once per call of the function."""
        name = f"%m{len(self._reserved)}"
        self._reserved.append(f"{name} = alloca {type}, i32 {count}, align {max(type.size, 1) if type.lanes else 16}")
        return Value(self, PTR, name)

    def jump(self, label: str) -> None:
        """Continue at a label."""
        self._close(f"br label %{label}")

    def branch(self, condition: Value, label: str) -> None:
        """Continue at a label if a condition holds."""
        onward = self._label()
        self._close(f"br {condition}, label %{label}, label %{onward}")
        self._begin(onward)

    def text(self) -> list[str]:
        """The body of the finished function."""
        if self._open:
            self._close("ret void" if self._result is None else "unreachable")
        return ["entry:", *self._reserved, "br label %body", "body:", *self._lines]

    def _label(self) -> str:
        self._count += 1
        return f"b{self._count}"

    def _begin(self, label: str) -> None:
        self._lines.append(f"{label}:")
        self._open = True

    def _close(self, text: str) -> None:
        self._write(text)
        self._open = False

    def _write(self, text: str) -> None:
        if not self._open:
            # What follows a jump is never reached, but LLVM wants each block to have a label.
            self._begin(self._label())
        self._lines.append(text)


class Otherwise:
    """The two parts of `Function.either`."""

    def __init__(self, function: Function, other: str, after: str) -> None:
        self._function, self._other, self._after = function, other, after
        self._turned = False

    def otherwise(self) -> None:
        """End the first part and begin the second."""
        self._function.jump(self._after)
        self._function._begin(self._other)
        self._turned = True

    def finish(self) -> None:
        """End both parts."""
        if not self._turned:
            self.otherwise()
        self._function.jump(self._after)
        self._function._begin(self._after)


class Module:
    """Functions that are compiled together."""

    def __init__(self) -> None:
        self._declared: set[str] = set()
        self._functions: list[str] = []

    def declare(self, text: str) -> None:
        """Note that a function from elsewhere is used."""
        self._declared.add(text)

    @contextmanager
    def function(
        self, name: str, parameters: Sequence[tuple[str, Type]], result: Type | None = None, internal: bool = False
    ) -> Iterator[Function]:
        """Build a function. One that is `internal` can only be called by others of the module.

        Memory that two pointers among the parameters lead to mustn't overlap.
        """
        function = Function(self, parameters, result)
        yield function
        arguments = ", ".join(f"{type}{' noalias' if type == PTR else ''} %{name}" for name, type in parameters)
        body = "\n".join(line if line.endswith(":") else f"  {line}" for line in function.text())
        linkage, prefix = ("internal ", "") if internal else ("", "{prefix}")
        self._functions.append(f"define {linkage}{result or 'void'} @{prefix}{name}({arguments}) #0 {{\n{body}\n}}\n")

    def text(self) -> str:
        """The module in LLVM's language.

        ``{prefix}`` stands before the names of functions that aren't internal; attribute group 0, the target, is
        left to the compiler.
        """
        return "\n".join([*self._functions, *sorted(self._declared), ""])
