"""The reading of OBJ files as functions in LLVM's language: lines to numbers, corners to vertices.

They know the files that programs write, and no others: a function that meets anything else gives `UNKNOWN`, and
`djpt.shapes.meshes.obj` reads the file again with care.
"""

from __future__ import annotations

from collections.abc import Sequence

from djpt.jit.llvm.arithmetic import select
from djpt.jit.llvm.ir import I32, I64, PTR, Function, Module, Value
from djpt.shapes.meshes.obj_text import BLANK, HASH, NEWLINE, Text, add_text_functions, any_of, fail_if

__all__ = ["CORNERS", "FACES", "LINES", "TRIANGLES", "WIDTHS", "add_obj_functions"]

SLASH = ord("/")
V, T, N, FACE = b"vtnf"

POSITION, TEXCOORD, NORMAL = range(3)
WIDTHS = (3, 2, 3)
"""Numbers of a position, a texture coordinate and a normal; a line may have more, which are ignored."""

LINES, FACES, CORNERS, TRIANGLES = 3, 3, 4, 5
"""Where counts stand: those of the three kinds of lines first."""


def add_obj_functions(module: Module) -> None:
    """Add `measure`, `scan`, `merge`, `pick` and `cut` to a module."""
    add_text_functions(module)
    add_measure(module)
    add_scan(module)
    add_merge(module)
    add_pick(module)
    add_cut(module)


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
    """Cut faces with some numbers of corners into fans around their first, as `djpt.shapes.meshes.polygons`."""
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
