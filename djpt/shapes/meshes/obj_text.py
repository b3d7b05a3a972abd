"""The characters, numbers and indices of OBJ files, read by functions in LLVM's language."""

from __future__ import annotations

from collections.abc import Sequence

from djpt.jit.llvm.arithmetic import minimum, select
from djpt.jit.llvm.ir import F32, F64, I8, I32, I64, PTR, Function, Module, Value

__all__ = ["BLANK", "EXACT_POWERS", "HASH", "NEWLINE", "UNKNOWN", "Text", "add_text_functions", "any_of", "fail_if"]

UNKNOWN = 0
"""The result of a function that doesn't understand its input; else results are above 0."""

EXACT_POWERS = 22
"""The largest power of ten that double precision holds exactly."""

EXACT = 1 << 53
"""Whole numbers below this are exact in double precision."""

LARGEST = (1 << 64) // 10 - 1
"""Up to this a number can take one more digit."""

GUARD = 2.0**-51
"""More than the relative error of two operations on a rounded number."""

NEWLINE, BLANK, TAB = b"\n \t"
HASH, MINUS, PLUS, POINT = b"#-+."
EXPONENT, EXPONENT_TOO = b"eE"


def add_text_functions(module: Module) -> None:
    """Add the functions that `Text` calls to a module: `number` and `index`."""
    add_number(module)
    add_index(module)


class Text:
    """A text that ends in a newline, and how far it was read."""

    def __init__(self, f: Function, start: Value, place: Value | int = 0) -> None:
        self.f, self._start = f, start
        self._place = f.variable(I64, place)

    @property
    def place(self) -> Value:
        """How many characters were read."""
        return self._place.value

    @property
    def next(self) -> Value:
        """The next character."""
        return self.f.load(I8, self._start.at(self.place))

    def skip(self) -> None:
        """Go on by one character."""
        self._place.value = self.place + 1

    def skip_blanks(self) -> None:
        """Go on to the next character that isn't blank."""
        with self.f.loop() as turns:
            turns.stop_if(~is_blank(self.next))
            self.skip()

    def skip_line(self) -> None:
        """Go on to the next line."""
        with self.f.loop() as turns:
            last = self.next
            self.skip()
            turns.stop_if(last == NEWLINE)

    def skip_if(self, *characters: int) -> Value:
        """Go on if the next character is one of some; return whether it was."""
        met = any_of(self.next, characters)
        with self.f.when(met):
            self.skip()
        return met

    def end_word(self) -> None:
        """Give up unless a word ends here."""
        character = self.next
        fail_if(self.f, ~(is_blank(character) | any_of(character, (NEWLINE, HASH))))

    def digits(self, number: Value | int) -> tuple[Value, Value]:
        """Read decimal digits behind those of a number: the new number, and how many digits there were."""
        f, start = self.f, self.place
        result = f.variable(I64, number)
        with f.loop() as turns:
            digit = self.next - ord("0")
            turns.stop_if(digit > 9)
            fail_if(f, result.value > LARGEST)
            result.value = result.value * 10 + digit.to(I64)
            self.skip()
        return result.value, self.place - start

    # ---- numbers ---------------------------------------------------------------------------------

    def read_number(self, powers: Value, target: Value) -> None:
        """Read a number and write it, rounded to double and then to single precision; `powers`: those of ten."""
        self._call("number", powers, target)

    def read_index(self, count: Value, target: Value) -> None:
        """Read an index that counts from 1, or backwards from the last of `count` entries, and write it."""
        self._call("index", count, target)

    def _call(self, name: str, *arguments: Value) -> None:
        place = self.f.call(name, [self._start, self.place, *arguments], I64)
        assert place is not None
        fail_if(self.f, place == UNKNOWN)
        self._place.value = place


# ---- numbers -----------------------------------------------------------------------------------------------------


def add_number(module: Module) -> None:
    """Read a number and write it as a float; give the place behind it."""
    parameters = [("text", PTR), ("place", I64), ("powers", PTR), ("target", PTR)]
    with module.function("number", parameters, I64, internal=True) as f:
        start, place, powers, target = f.parameters
        text = Text(f, start, place)
        negative = text.next == MINUS
        text.skip_if(MINUS, PLUS)
        before, count = text.digits(0)
        whole, digits, decimals = f.variable(I64, before), f.variable(I64, count), f.variable(I64, 0)
        with f.when(text.skip_if(POINT)):
            whole.value, decimals.value = text.digits(whole.value)
            digits.value = digits.value + decimals.value
        fail_if(f, digits.value == 0)
        # The power of ten as a divisor and, if there is an exponent, as a factor.
        down, up = decimals, f.variable(I64, 0)
        with f.when(text.skip_if(EXPONENT, EXPONENT_TOO)):
            below = text.next == MINUS
            text.skip_if(MINUS, PLUS)
            exponent, count = text.digits(0)
            fail_if(f, (count == 0) | (exponent > 99))
            down.value = select(below, down.value + exponent, down.value)
            up.value = select(below, up.value, exponent)
            common = minimum(down.value, up.value)
            down.value, up.value = down.value - common, up.value - common
        text.end_word()
        size = scaled(f, whole.value, down.value, up.value, powers)
        f.store(select(negative, -size, size), target)
        f.give(text.place)


def add_index(module: Module) -> None:
    """Read an index and write it, counted from 1, in 32 bits; give the place behind it."""
    parameters = [("text", PTR), ("place", I64), ("count", I64), ("target", PTR)]
    with module.function("index", parameters, I64, internal=True) as f:
        start, place, count, target = f.parameters
        text = Text(f, start, place)
        negative = text.skip_if(MINUS)
        number, digits = text.digits(0)
        fail_if(f, (digits == 0) | (digits > 9) | (negative & ((number == 0) | (number > count))))
        f.store(select(negative, count + 1 - number, number).to(I32), target)
        f.give(text.place)


def scaled(f: Function, whole: Value, down: Value, up: Value, powers: Value) -> Value:
    """A number times one power of ten and divided by another, of which one is 1; rounded as by `Text.read_number`.

    If all operands are exact, one operation gives the double that is nearest. Else the result may be off by its last
    bits, which usually get lost in single precision; where they matter the function gives up.
    """
    number, result = whole.to(F64), f.variable(F32, 0.0)

    def power(exponent: Value) -> Value:
        return f.load(F64, powers.at(exponent * 8))

    with f.either((whole < EXACT) & (down <= EXACT_POWERS) & (up <= EXACT_POWERS)) as branch:
        with f.either(up == 0) as small:
            result.value = (number / power(down)).to(F32)
            small.otherwise()
            result.value = (number * power(up)).to(F32)
        branch.otherwise()
        with f.when(whole != 0):
            fail_if(f, (down > 2 * EXACT_POWERS) | (up > EXACT_POWERS))
            first = minimum(down, EXACT_POWERS)
            about = number / power(first) / power(down - first) * power(up)
            low, high = ((about * factor).to(F32) for factor in (1 - GUARD, 1 + GUARD))
            fail_if(f, low != high)
            result.value = low
    return result.value


# ---- characters --------------------------------------------------------------------------------------------------


def any_of(character: Value, possible: Sequence[int]) -> Value:
    """Whether a character is one of some."""
    result = character == possible[0]
    for other in possible[1:]:
        result = result | (character == other)
    return result


def is_blank(character: Value) -> Value:
    """Whether a character separates words: a space, or one from tab to carriage return but for the newline."""
    return (character == BLANK) | ((character - TAB < 5) & (character != NEWLINE))


def fail_if(f: Function, condition: Value) -> None:
    """Give up if a condition holds."""
    with f.when(condition):
        f.give(UNKNOWN)
