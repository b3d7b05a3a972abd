"""A builder of LLVM IR: machine code written as Python, with operators and structured control flow.

Dr.Jit records what a kernel does for every lane. Some algorithms don't fit that form: a traversal that
tests eight boxes of one node at once, or the construction of a tree. They are written with this builder
and compiled by `djpt.jit.llvm.compiler`::

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
from functools import cache

from djpt.errors import DjptError
from djpt.jit.llvm.values import F32, F64, I1, I8, I16, I32, I64, PTR, Array, Operand, Type, Value, Variable, vector

__all__ = [
    "F32",
    "F64",
    "I1",
    "I8",
    "I16",
    "I32",
    "I64",
    "LINE",
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

LINE = 64
"""Bytes of a cache line."""


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
        self.parameters = [Value(self, type, f"%{name}.") for name, type in parameters]

    # ---- values ----------------------------------------------------------------------------

    def constant(self, type: Type, value: Operand) -> Value:
        """A number as a constant; a value stays itself, a scalar is spread if `type` is a vector.

        Raises:
            DjptError: The value has another type, or the type has no such number. Floats are rounded.
        """
        if isinstance(value, Value):
            value = value.spread(type.lanes) if type.lanes and not value.type.lanes else value
            if value.type != type:
                raise DjptError(f"operands of different types, {type} and {value.type}")
            return value
        if type.lanes:
            element = self.constant(type.element, value)
            return Value(self, type, "<" + ", ".join([str(element)] * type.lanes) + ">")
        if type.kind == "ptr":
            raise DjptError(f"{value} can't be a constant of type ptr")
        write = float_text if type.kind == "f" else integer_text
        try:
            return Value(self, type, write(value, type.bits))
        except (OverflowError, ValueError):
            raise DjptError(f"{type} has no number {value}") from None

    def constants(self, element: Type, numbers: Sequence[float]) -> Value:
        """A vector of constants."""
        lanes = ", ".join(str(self.constant(element, number)) for number in numbers)
        return Value(self, vector(element, len(numbers)), f"<{lanes}>")

    def like(self, value: Value, number: Operand) -> Value:
        """A number as a constant of a value's type."""
        return self.constant(value.type, number)

    def matched(self, a: Operand, b: Operand) -> tuple[Value, Value]:
        """Two operands as values of one type; at least one is a value."""
        values = [x for x in (a, b) if isinstance(x, Value)]
        type = next((x.type for x in values if x.type.lanes), values[0].type)
        return self.constant(type, a), self.constant(type, b)

    def variable(self, type: Type, initial: Operand) -> Variable:
        """A new variable."""
        result = Variable(self, type)
        result.value = initial
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

    def exchange(self, value: Value, address: Value) -> Value:
        """Write a number to memory and return the one that was there, in one step for all threads.

        What other threads had written before they wrote this number by `exchange` or `publish` is seen afterwards.
        """
        return self.emit(f"atomicrmw xchg {address}, {value} acq_rel", value.type)

    def publish(self, value: Value, address: Value) -> None:
        """Write a number to memory after all that this thread has written before: see `exchange`."""
        self._write(f"store atomic {value}, {address} release, align {value.type.size}")

    def prefetch(self, address: Value) -> None:
        """Ask for the cache line of an address, which will be read soon."""
        self.module.declare("declare void @llvm.prefetch.p0(ptr, i32, i32, i32)")
        # For reading, to be kept in all levels, data.
        self._write(f"call void @llvm.prefetch.p0({address}, i32 0, i32 3, i32 1)")

    def intrinsic(self, name: str, arguments: Sequence[Value], result: Type, suffix: str | None = None) -> Value:
        """Call a function that is built into LLVM, such as sqrt.

        Its name ends in the type of the result, or in another `suffix`. Instructions of processors have none: "".
        """
        suffix = result.suffix if suffix is None else suffix
        full = f"llvm.{name}.{suffix}" if suffix else f"llvm.{name}"
        self.module.declare(f"declare {result} @{full}({', '.join(str(a.type) for a in arguments)})")
        return self.emit(f"call {result} @{full}({', '.join(str(a) for a in arguments)})", result)

    def table(self, name: str, element: Type, numbers: Sequence[int]) -> Value:
        """The address of constant integers in memory, which the functions of a module share by their `name`."""
        listed = table_text(element, tuple(numbers))
        self.module.declare(f"@{name} = internal constant [{len(numbers)} x {element}] [{listed}], align {LINE}")
        return Value(self, PTR, f"@{name}")

    def call(self, name: str, arguments: Sequence[Value], result: Type | None = None) -> Value | None:
        """Call an internal function of the module."""
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
        index = self.variable(I64, first)
        with self.loop() as turns:
            i = index.value
            turns.stop_if(i >= end)
            index.value = i + 1
            yield i

    @contextmanager
    def each_backwards(self, first: Operand, end: Operand) -> Iterator[Value]:
        """Run what is built inside for every whole number below `end` down to `first`."""
        index = self.variable(I64, end)
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
        align = 1 << (type.size - 1).bit_length() if type.size > 1 and type.lanes else 16
        self._reserved.append(f"{name} = alloca {type}, i32 {count}, align {align}")
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
        arguments = ", ".join(f"{type}{' noalias' if type == PTR else ''} %{name}." for name, type in parameters)
        body = "\n".join(line if line.endswith(":") else f"  {line}" for line in function.text())
        linkage, prefix = ("internal ", "") if internal else ("", "{prefix}")
        self._functions.append(f"define {linkage}{result or 'void'} @{prefix}{name}({arguments}) #0 {{\n{body}\n}}\n")

    def text(self) -> str:
        """The module in LLVM's language.

        ``{prefix}`` stands before the names of functions that aren't internal; attribute group 0, the target, is
        left to the compiler.
        """
        return "\n".join([*self._functions, *sorted(self._declared), ""])


@cache
def table_text(element: Type, numbers: tuple[int, ...]) -> str:
    """The entries of a table; kept, because a function names its tables at each use."""
    return ", ".join(f"{element} {integer_text(number, element.bits)}" for number in numbers)


def float_text(number: float, bits: int) -> str:
    """A float as LLVM writes it: as the bits of a double, also if it has 32 bits."""
    exact = struct.unpack("<f", struct.pack("<f", number))[0] if bits == 32 else number
    return f"0x{struct.unpack('Q', struct.pack('d', exact))[0]:016X}"


def integer_text(number: float, bits: int) -> str:
    """An integer, unsigned; negative numbers become their two's complement."""
    whole = int(number)
    if whole != number or not -(1 << bits) // 2 <= whole < 1 << bits:
        raise ValueError
    return str(whole & ((1 << bits) - 1))
