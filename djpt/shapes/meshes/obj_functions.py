"""The reading of OBJ files as functions in LLVM's language: characters to numbers, lines to rows, corners to vertices.

They know the files that programs write, and no others: a function that meets anything else gives `UNKNOWN`, and
`djpt.shapes.meshes.obj` reads the file again line by line.
"""

from __future__ import annotations

from collections.abc import Sequence

from djpt.jit.llvm.arithmetic import minimum, select
from djpt.jit.llvm.ir import F32, F64, I8, I32, I64, PTR, Function, Module, Value

__all__ = ["CORNERS", "EXACT_POWERS", "FACES", "LINES", "TRIANGLES", "UNKNOWN", "WIDTHS", "add_obj_functions"]

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

SLASH = ord("/")
V, T, N, FACE = b"vtnf"

POSITION, TEXCOORD, NORMAL = range(3)
WIDTHS = (3, 2, 3)
"""Numbers of a position, a texture coordinate and a normal; a line may have more, which are ignored."""

LINES, FACES, CORNERS, TRIANGLES = 3, 3, 4, 5
"""The places of counts in their array: those of the three kinds of lines first."""


def add_obj_functions(module: Module) -> None:
    """Add `measure`, `scan`, `merge`, `pick` and `cut` to a module."""
    add_number(module)
    add_index(module)
    add_measure(module)
    add_scan(module)
    add_merge(module)
    add_pick(module)
    add_cut(module)


# ---- text --------------------------------------------------------------------------------------------------------


class Text:
    """A text that ends in a newline, and how far it was read."""

    def __init__(self, f: Function, start: Value, place: Value | int = 0) -> None:
        self.f, self._start = f, start
        self._place = f.variable(I64, place)

    @property
    def place(self) -> Value:
        """The number of characters read."""
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


# ---- lines -------------------------------------------------------------------------------------------------------


def add_measure(module: Module) -> None:
    """Count the lines of each kind, and the words of faces: at least as many as `scan` will find.

    Results: see `LINES`; no triangles are counted.
    """
    with module.function("measure", [("text", PTR), ("size", I64), ("counts", PTR)], I64) as f:
        start, size, counts = f.parameters
        text = Text(f, start)
        found = [f.variable(I64, 0) for _ in range(CORNERS + 1)]
        with f.loop() as lines:
            lines.stop_if(text.place >= size)
            text.skip_blanks()
            first = text.next
            with f.either(first == FACE) as branch:
                found[FACES].value = found[FACES].value + 1
                filled = f.variable(I64, 1)
                with f.loop() as characters:
                    text.skip()
                    character = text.next
                    characters.stop_if(character == NEWLINE)
                    now = select(character > BLANK, f.constant(I64, 1), 0)
                    found[CORNERS].value = found[CORNERS].value + (now & ~filled.value)
                    filled.value = now
                branch.otherwise()
                with f.when(first == V):
                    text.skip()
                    for kind, letter in enumerate((None, T, N)):
                        mine = ~any_of(text.next, (T, N)) if letter is None else text.next == letter
                        found[kind].value = found[kind].value + select(mine, f.constant(I64, 1), 0)
            text.skip_line()
        write_counts(f, counts, [variable.value for variable in found])
        f.give(1)


def add_scan(module: Module) -> None:
    """Read all lines.

    Positions, texture coordinates and normals are written as floats; of faces the numbers of corners (32 bits) and for
    each corner the indices of the three (32 bits; 0: none), whose range isn't checked. Results: see `LINES`.
    """
    names = ("text", "positions", "texcoords", "normals", "faces", "corners", "counts", "powers")
    with module.function("scan", [*((name, PTR) for name in names), ("size", I64)], I64) as f:
        start, *tables, faces, corners, counts, powers, size = f.parameters
        text = Text(f, start)
        lines = [f.variable(I64, 0) for _ in range(LINES)]
        face, corner, triangle = (f.variable(I64, 0) for _ in range(3))
        with f.loop() as turns:
            turns.stop_if(text.place >= size)
            text.skip_blanks()
            first = text.next
            fail_if(f, (first < BLANK) & (first != NEWLINE))
            with f.when(first == V):
                text.skip()
                second = text.next
                with f.when(any_of(second, (T, N))):
                    text.skip()
                with f.when((text.next <= BLANK) | (text.next == HASH)):
                    for kind, letter in enumerate((None, T, N)):
                        with f.when(~any_of(second, (T, N)) if letter is None else second == letter):
                            row = tables[kind].at(lines[kind].value * (4 * WIDTHS[kind]))
                            for k in range(WIDTHS[kind]):
                                text.skip_blanks()
                                text.read_number(powers, row.at(4 * k))
                            lines[kind].value = lines[kind].value + 1
            with f.when(first == FACE):
                text.skip()
                with f.when((text.next <= BLANK) | (text.next == HASH)):
                    before = corner.value
                    with f.loop() as words:
                        text.skip_blanks()
                        words.stop_if(any_of(text.next, (NEWLINE, HASH)))
                        read_corner(text, [line.value for line in lines], corners.at(corner.value * 12))
                        corner.value = corner.value + 1
                    count = corner.value - before
                    f.store(count.to(I32), faces.at(face.value * 4))
                    face.value = face.value + 1
                    triangle.value = triangle.value + select(count > 2, count - 2, 0)
            text.skip_line()
        write_counts(f, counts, [variable.value for variable in (*lines, face, corner, triangle)])
        f.give(1)


def read_corner(text: Text, counts: Sequence[Value], target: Value) -> None:
    """Read ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``; `counts` are those of the lines above."""
    f = text.f
    places = [target.at(4 * k) for k in range(3)]
    for place in places[1:]:
        f.store(f.constant(I32, 0), place)
    text.read_index(counts[POSITION], places[POSITION])
    with f.when(text.skip_if(SLASH)):
        with f.when(text.next != SLASH):
            text.read_index(counts[TEXCOORD], places[TEXCOORD])
        with f.when(text.skip_if(SLASH)):
            text.read_index(counts[NORMAL], places[NORMAL])
    text.end_word()


# ---- vertices ----------------------------------------------------------------------------------------------------


def add_merge(module: Module) -> None:
    """Number the distinct corners in the order of their first use; give one more than their number.

    Corners with equal sums of indices, more or less, form a chain: `chains` has the number of its last vertex from 1,
    and `links` that of the one before. `chains` must be zeros, a power of two of them, of which `mask` is one less.
    Vertices get the indices of their corners. An index out of the range that `counts` gives is unknown.
    """
    names = ("corners", "counts", "chains", "links", "vertices", "numbers")
    parameters = [*((name, PTR) for name in names), ("count", I64), ("mask", I64)]
    with module.function("merge", parameters, I64) as f:
        corners, counts, chains, links, vertices, numbers, count, mask = f.parameters
        most = [f.load(I64, counts.at(8 * k)).to(I32) for k in range(3)]
        vertex = f.variable(I32, 0)
        with f.each(0, count) as corner:
            source = corners.at(corner * 12)
            indices = [f.load(I32, source.at(4 * k)) for k in range(3)]
            a, b, c = (index > limit for index, limit in zip(indices, most, strict=True))
            fail_if(f, a | b | c | (indices[POSITION] == 0))
            chain = chains.at((mixed(indices) & mask) * 4)
            number = f.variable(I32, f.load(I32, chain))
            with f.loop() as turns:
                with f.when(number.value == 0):
                    target = vertices.at(vertex.value * 12)
                    for k, index in enumerate(indices):
                        f.store(index, target.at(4 * k))
                    f.store(f.load(I32, chain), links.at(vertex.value * 4))
                    vertex.value = vertex.value + 1
                    f.store(vertex.value, chain)
                    number.value = vertex.value
                    turns.stop()
                known = vertices.at((number.value - 1) * 12)
                a, b, c = (f.load(I32, known.at(4 * k)) == index for k, index in enumerate(indices))
                turns.stop_if(a & b & c)
                number.value = f.load(I32, links.at((number.value - 1) * 4))
            f.store(number.value - 1, numbers.at(corner * 4))
        f.give(vertex.value.to(I64) + 1)


def mixed(indices: Sequence[Value]) -> Value:
    """A number that neighbours don't share, and that leads to places near theirs."""
    a, b, c = (index.to(I64) for index in indices)
    return a + b * 3 + c * 5


def add_pick(module: Module) -> None:
    """Copy the rows of a table, of `width` 32-bit words, that some vertices have at `column`; zeros for index 0.

    Gives 1 if all indices are 0, else 2.
    """
    parameters = [("table", PTR), ("vertices", PTR), ("target", PTR), *((n, I64) for n in ("column", "width", "count"))]
    with module.function("pick", parameters, I64) as f:
        table, vertices, target, column, width, count = f.parameters
        any_index, size = f.variable(I32, 0), width * 4
        with f.each(0, count) as vertex:
            index = f.load(I32, vertices.at(vertex * 12 + column * 4))
            any_index.value = any_index.value | index
            row, source = target.at(vertex * size), table.at((index.to(I64) - 1) * size)
            with f.each(0, width) as k:
                word = f.variable(I32, 0)
                with f.when(index != 0):
                    word.value = f.load(I32, source.at(k * 4))
                f.store(word.value, row.at(k * 4))
        f.give(select(any_index.value == 0, f.constant(I64, 1), 2))


def add_cut(module: Module) -> None:
    """Cut faces with some numbers of corners into fans around their first, as `djpt.shapes.meshes.ply.fans`."""
    parameters = [("faces", PTR), ("numbers", PTR), ("triangles", PTR), ("count", I64)]
    with module.function("cut", parameters, I64) as f:
        faces, numbers, triangles, count = f.parameters
        first, triangle = f.variable(I64, 0), f.variable(I64, 0)
        with f.each(0, count) as face:
            corners = f.load(I32, faces.at(face * 4)).to(I64)
            own = numbers.at(first.value * 4)
            with f.each(2, corners) as last:
                target = triangles.at(triangle.value * 12)
                for k, corner in enumerate((f.constant(I64, 0), last - 1, last)):
                    f.store(f.load(I32, own.at(corner * 4)), target.at(4 * k))
                triangle.value = triangle.value + 1
            first.value = first.value + corners
        f.give(1)


# ---- results ----------------------------------------------------------------------------------------------------


def write_counts(f: Function, target: Value, counts: Sequence[Value]) -> None:
    """Write numbers of 64 bits."""
    for k, count in enumerate(counts):
        f.store(count, target.at(8 * k))
