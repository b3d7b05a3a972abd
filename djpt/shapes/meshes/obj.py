"""The reader of meshes in Wavefront OBJ files.

A reader of our own: vertices must be merged and numbered as in Mitsuba (one for each distinct combination of
indices, in the order of first use), and errors must name the line, which libraries for many formats do not offer.

Files as programs write them are read by compiled functions, see `djpt.shapes.meshes.obj_functions`. All others are read
line by line: that is slower, but knows every form of a line, and says where and why one is wrong. Both give the same
meshes, bit for bit.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError
from djpt.jit.llvm.host import HostFunctions
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.meshes.obj_functions import (
    CORNERS,
    EXACT_POWERS,
    FACES,
    LINES,
    TRIANGLES,
    UNKNOWN,
    WIDTHS,
    add_obj_functions,
)

__all__ = ["read_compiled", "read_obj", "read_plainly"]

PARAMETERS = {"measure": 3, "scan": 9, "merge": 8, "pick": 6, "cut": 4}
"""The compiled functions, and how many parameters each has."""

FUNCTIONS = HostFunctions(add_obj_functions, PARAMETERS, small=1 << 15, few=16)
"""The functions that read large files, or many."""

POWERS = np.array([float(10**k) for k in range(EXACT_POWERS + 1)])

KINDS = {b"v": "vertex", b"vt": "texture coordinate", b"vn": "normal"}
"""The keywords of lines with numbers, and what messages call them."""

CORNER = re.compile(rb"([+-]?\d{1,18})(?:/([+-]?\d{1,18})?(?:/([+-]?\d{1,18})?)?)?")
"""A corner of a face: ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``; as in Mitsuba, nothing after a slash is no entry."""

Key = tuple[int, int, int]
"""The numbers of a corner's vertex, texture coordinate and normal, counted from 1; 0: none; -1: before the first."""


def read_obj(data: bytes, where: str) -> MeshData:
    """Read the mesh in an OBJ file: all its groups and objects together.

    Polygons become fans of triangles. Indices may be negative (counted back from the line). A corner
    without texture coordinates gets (0, 0) if others have some; one without a normal gets none.
    Materials, groups, lines and curves are ignored. A backslash at the end of a line joins it with the next one.

    Args:
        data: the file's contents.
        where: names the file in messages.

    Raises:
        SceneError: a line that can't be understood, or a reference to something that isn't there.
    """
    return read_compiled(data) or read_plainly(data, where)


# ---- compiled ----------------------------------------------------------------------------------------------------


def read_compiled(data: bytes) -> MeshData | None:
    """Read the mesh in an OBJ file by compiled functions; None if `read_plainly` must do it.

    That is so for files that have a mistake or very long numbers, for the first few if they are small, and without
    LLVM.
    """
    run = FUNCTIONS.for_size(len(data))
    if run is None:
        return None
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\\\n" in data:
        data = data.replace(b"\\\n", b"  ")
    data += b"\n"
    text = np.frombuffer(data, np.uint8)
    counts = np.zeros(TRIANGLES + 1, np.int64)
    run("measure", text, len(data), counts)
    tables = [np.empty((n, width), np.float32) for n, width in zip(counts[:LINES], WIDTHS, strict=True)]
    faces, corners = np.empty(counts[FACES], np.uint32), np.empty((counts[CORNERS], 3), np.uint32)
    if run("scan", text, *tables, faces, corners, counts, POWERS, len(data)) == UNKNOWN:
        return None
    total = int(counts[CORNERS])
    chains = np.zeros(1 << int(counts[:LINES].max()).bit_length(), np.uint32)
    links, numbers = np.empty(total, np.uint32), np.empty(total, np.uint32)
    vertices = np.empty((total, 3), np.uint32)
    distinct = run("merge", corners, counts, chains, links, vertices, numbers, total, len(chains) - 1) - 1
    if distinct < 0:
        return None
    indices = np.empty((counts[TRIANGLES], 3), np.uint32)
    run("cut", faces, numbers, indices, int(counts[FACES]))
    columns: list[NDArray[np.float32] | None] = []
    for k, (table, width) in enumerate(zip(tables, WIDTHS, strict=True)):
        rows = np.empty((distinct, width), np.float32)
        used = run("pick", table, vertices, rows, k, width, distinct) > 1
        columns.append(rows if used or k == 0 else None)
    positions, texcoords, normals = columns
    assert positions is not None
    return MeshData(positions, indices, normals, texcoords)


# ---- line by line ------------------------------------------------------------------------------------------------


def read_plainly(data: bytes, where: str) -> MeshData:
    """Do what `read_obj` does line by line."""
    tables: dict[bytes, list[list[float]]] = {kind: [] for kind in KINDS}
    vertices: dict[Key, int] = {}
    lines: list[int] = []  # where each vertex is used first
    known: dict[bytes, int] = {}
    triangles: list[tuple[int, int, int]] = []
    for line, (kind, *words) in split_lines(data):
        if kind in KINDS:
            tables[kind].append(read_numbers(words, kind, where, line))
        elif kind == b"f":
            polygon = []
            for word in words:
                vertex = known.get(word)
                if vertex is None:
                    key = read_corner(word, [len(table) for table in tables.values()], where, line)
                    vertex = vertices.setdefault(key, len(vertices))
                    if vertex == len(lines):
                        lines.append(line)
                    # What a negative index means depends on the line.
                    if b"-" not in word:
                        known[word] = vertex
                polygon.append(vertex)
            triangles += [(polygon[0], a, b) for a, b in pairwise(polygon[1:])]
    check_range(vertices, lines, [len(table) for table in tables.values()], where)
    keys = np.array(list(vertices), np.int64).reshape(-1, 3)
    positions, texcoords, normals = (
        pick(table, width, keys[:, k]) for k, (table, width) in enumerate(zip(tables.values(), WIDTHS, strict=True))
    )
    return MeshData(
        positions,
        np.array(triangles, np.uint32).reshape(-1, 3),
        normals if keys[:, 2].any() else None,
        texcoords if keys[:, 1].any() else None,
    )


def split_lines(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """The words of each line that has any, and its number; a joined line has the number of its first part."""
    lines = enumerate(data.splitlines(), 1)
    for number, line in lines:
        while line.endswith(b"\\"):
            line = line[:-1] + b" " + next(lines, (0, b""))[1]
        words = line.partition(b"#")[0].split()
        if words:
            yield number, words


def read_numbers(words: list[bytes], kind: bytes, where: str, line: int) -> list[float]:
    """Read the first two or three numbers of a line; further ones are ignored (colours, weights)."""
    least = WIDTHS[list(KINDS).index(kind)]
    if len(words) < least:
        found = "found fewer words"
    else:
        try:
            return [float(word) for word in words[:least]]
        except ValueError:
            # Not what was found: the file may be anything that its owner can read, and the scene a stranger's.
            found = "found other words"
    raise SceneError(f"{where}, line {line}: '{kind.decode()}' must be followed by {least} numbers, {found}")


def read_corner(word: bytes, counts: list[int], where: str, line: int) -> Key:
    """Read a corner of a face; negative indices, of which -1 is the last entry so far, become counts from 1.

    `counts`: entries of each kind in the lines above.
    """
    match = CORNER.fullmatch(word)
    if match is None:
        raise SceneError(
            f"{where}, line {line}: can't understand the corner '{word.decode('latin-1')[:40]}' of a face; "
            "possible: v, v/vt, v//vn, v/vt/vn with whole numbers"
        )
    numbers = [int(number or 0) for number in match.groups()]
    # An index before the first entry must not turn into 0, which means none.
    a, b, c = (
        (number + count + 1 if number + count >= 0 else -1) if number < 0 else number
        for number, count in zip(numbers, counts, strict=True)
    )
    return a, b, c


def check_range(vertices: dict[Key, int], lines: list[int], sizes: list[int], where: str) -> None:
    """Raise `SceneError` for the first reference to something that doesn't exist."""
    for key, line in zip(vertices, lines, strict=True):
        for k, (number, size, name) in enumerate(zip(key, sizes, KINDS.values(), strict=True)):
            if 0 < number <= size or (number == 0 and k > 0):
                continue
            found = "before the first" if number < 0 else str(number)
            have = f"there are {size}, counted from 1" if size else "there is none"
            raise SceneError(f"{where}, line {line}: a face refers to the {name} {found}; {have}")


def pick(table: list[list[float]], width: int, index: NDArray[np.int64]) -> NDArray[np.float32]:
    """Pick rows of a table by numbers from 1; zeros for 0."""
    with np.errstate(over="ignore"):
        rows = np.array([[0.0] * width, *table], np.float64).astype(np.float32)
    return rows[index]
