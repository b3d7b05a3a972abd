"""The reader of meshes in Wavefront OBJ files.

A reader of our own: vertices must be merged and numbered as in Mitsuba (one for each distinct combination of
indices, in the order of first use), and errors must name the line, which libraries for many formats do not offer.

Files as programs write them are read by compiled functions. All others are read by NumPy: it knows every form of a
line, and where a line is wrong it says why. Both give the same meshes, bit for bit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.meshes.obj_compiled import read_compiled
from djpt.shapes.meshes.obj_lines import Lines, parse, sort_lines, word_starts
from djpt.shapes.meshes.polygons import fans

__all__ = ["read_obj"]

NAMES = ("vertex", "texture coordinate", "normal")
LEAST = {"v": 3, "vt": 2, "vn": 3}
"""How many numbers a line of each kind must have; further ones are ignored (colours, weights)."""

SLASH = ord("/")
LONE_SLASH = re.compile(rb"/(?=\s|$)")


@dataclass
class Corners:
    """All corners of all faces."""

    keys: NDArray[np.int64]
    """The numbers of vertex, texture coordinate and normal, (N, 3), counted from 1; 0: none."""
    counts: NDArray[np.int64]
    """How many corners each face has."""


def read_obj(data: bytes, where: str) -> MeshData:
    """Read the mesh in an OBJ file: all its groups and objects together.

    Polygons become fans of triangles. Indices may be negative (counted back from the line). A corner
    without texture coordinates gets (0, 0) if others have some; one without a normal gets none.
    Materials, groups, lines and curves are ignored.

    Args:
        data: the file's contents.
        where: names the file in messages.

    Raises:
        SceneError: a line that can't be understood, or a reference to something that isn't there.
    """
    return read_compiled(data) or read_carefully(data, where)


def read_carefully(data: bytes, where: str) -> MeshData:
    """Do what `read_obj` does by NumPy."""
    lines = sort_lines(data)
    tables = {kind: read_numbers(lines[kind], kind, where) for kind in LEAST}
    corners = read_corners(lines["f"], where)
    sizes = [len(table) for table in tables.values()]
    resolve_negative(corners, lines)
    check_range(corners, sizes, lines["f"].numbers, where)
    keys, own = first_use(corners.keys, sizes)
    positions = tables["v"][keys[:, 0] - 1]
    texcoords = pick(tables["vt"], keys[:, 1])
    normals = pick(tables["vn"], keys[:, 2])
    indices = own.astype(np.uint32)
    if (corners.counts == 3).all():
        return MeshData(positions, indices.reshape(-1, 3), normals, texcoords)
    triangles, _ = fans(corners.counts)
    return MeshData(positions, indices[triangles], normals, texcoords)


def read_numbers(lines: Lines, kind: str, where: str) -> NDArray[np.float32]:
    """Read the first two or three numbers of each line of a kind, (N, 2) or (N, 3)."""
    count, least = len(lines.numbers), LEAST[kind]
    if not count:
        return np.zeros((0, least), np.float32)
    width = int(lines.words[0])
    if width >= least and (lines.words == width).all():
        flat = parse(lines.text, np.float64)
        if flat is not None and len(flat) == count * width:
            with np.errstate(over="ignore"):
                return flat.reshape(count, width)[:, :least].astype(np.float32)
    result = np.empty((count, least), np.float32)
    for i, row in enumerate(lines.rows()):
        words = row.split()[:least]
        try:
            if len(words) < least:
                raise ValueError
            result[i] = [float(word) for word in words]
        except ValueError:
            at = f"{where}, line {lines.numbers[i]}"
            # Not what was found: the file may be anything that its owner can read, and the scene a stranger's.
            found = "found fewer words" if len(words) < least else "found other words"
            raise SceneError(f"{at}: '{kind}' must be followed by {least} numbers, {found}") from None
    return result


def read_corners(lines: Lines, where: str) -> Corners:
    """Read the corners of all faces: ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn`` each."""
    total = int(lines.words.sum())
    if not total:
        return Corners(np.zeros((0, 3), np.int64), lines.words)
    text = lines.text.replace(b"//", b"/0/")
    if LONE_SLASH.search(text):
        # As in Mitsuba, nothing after a slash is no entry.
        text = LONE_SLASH.sub(b"/0", text)
    characters = np.frombuffer(text, np.uint8)
    slash = characters == SLASH
    slashes = slashes_of_corners(np.flatnonzero(slash), word_starts(characters))
    flat = parse(text.replace(b"/", b" "), np.int64)
    if flat is None or slashes.max() > 2 or len(flat) != int(slashes.sum()) + total:
        raise bad_face(lines, where)
    keys = np.zeros((total, 3), np.int64)
    if (slashes == slashes[0]).all():
        keys[:, : slashes[0] + 1] = flat.reshape(total, -1)
        return Corners(keys, lines.words)
    first = np.cumsum(slashes + 1) - (slashes + 1)
    for k in range(3):
        has = slashes >= k
        keys[has, k] = flat[first[has] + k]
    return Corners(keys, lines.words)


def slashes_of_corners(slashes: NDArray[np.int64], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many slashes each corner has: those up to the start of the next one are its own."""
    each, rest = divmod(len(slashes), len(starts))
    if not rest:
        # Nearly always all corners have as many.
        if not each:
            return np.zeros(len(starts), np.int64)
        in_rows = slashes.reshape(-1, each)
        if (starts < in_rows[:, 0]).all() and (in_rows[:-1, -1] < starts[1:]).all():
            return np.full(len(starts), each)
    return np.diff(np.searchsorted(slashes, starts), append=len(slashes))


def bad_face(lines: Lines, where: str) -> SceneError:
    """The error for the first face that can't be understood."""
    for row, number in zip(lines.rows(), lines.numbers, strict=True):
        for word in row.split():
            parts = word.split(b"/")
            fine = len(parts) <= 3 and parts[0].removeprefix(b"-").isdigit()
            if not fine or not all(not part or part.removeprefix(b"-").isdigit() for part in parts[1:]):
                found = word.decode("latin-1")[:40]
                return SceneError(
                    f"{where}, line {number}: can't understand the corner '{found}' of a face; "
                    "possible: v, v/vt, v//vn, v/vt/vn with whole numbers"
                )
    return SceneError(f"{where}: a face has numbers that can't be read")


def resolve_negative(corners: Corners, lines: dict[str, Lines]) -> None:
    """Turn negative indices, of which -1 is the last entry before the face, into counts from 1, in place."""
    for k, kind in enumerate(LEAST):
        negative = np.flatnonzero(corners.keys[:, k] < 0)
        if len(negative):
            line = np.repeat(lines["f"].numbers, corners.counts)[negative]
            before = np.searchsorted(lines[kind].numbers, line)
            value = corners.keys[negative, k] + before + 1
            # An index before the first entry must not turn into 0, which means none.
            corners.keys[negative, k] = np.where(value > 0, value, -1)


def check_range(corners: Corners, sizes: list[int], numbers: NDArray[np.int64], where: str) -> None:
    """Raise `SceneError` for the first reference to something that doesn't exist."""
    keys = corners.keys
    bad = (keys < 0) | (keys > np.array(sizes))
    bad[:, 0] |= keys[:, 0] == 0
    if not bad.any():
        return
    row = int(np.argmax(bad.any(axis=1)))
    k = int(np.argmax(bad[row]))
    line = int(np.repeat(numbers, corners.counts)[row])
    number = "0" if keys[row, k] == 0 else f"{keys[row, k]}" if keys[row, k] > 0 else "before the first"
    have = f"there are {sizes[k]}, counted from 1" if sizes[k] else "there is none"
    raise SceneError(f"{where}, line {line}: a face refers to the {NAMES[k]} {number}; {have}")


def first_use(keys: NDArray[np.int64], sizes: list[int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The distinct keys in the order of first use, (V, 3), and for each corner the number of its key."""
    if all(not keys[:, k].any() or np.array_equal(keys[:, k], keys[:, 0]) for k in (1, 2)):
        # Usually the files number all three alike, if they have them.
        combined, size = keys[:, 0], sizes[0] + 1
    elif (sizes[0] + 1) * (sizes[1] + 1) * (sizes[2] + 1) < 2**62:
        combined = (keys[:, 0] * (sizes[1] + 1) + keys[:, 1]) * (sizes[2] + 1) + keys[:, 2]
        distinct, combined = np.unique(combined, return_inverse=True)
        size = len(distinct)
    else:
        distinct, combined = np.unique(keys, axis=0, return_inverse=True)
        size = len(distinct)
    # Writing backwards leaves the first use of each.
    first = np.full(size, -1)
    first[combined[::-1]] = np.arange(len(combined))[::-1]
    order = np.sort(first[first >= 0])
    rank = np.empty(size, np.int64)
    rank[combined[order]] = np.arange(len(order))
    return keys[order], rank[combined]


def pick(table: NDArray[np.float32], index: NDArray[np.int64]) -> NDArray[np.float32] | None:
    """Pick rows of a table by numbers from 1; zeros for 0. None if no number is above 0."""
    if not index.any():
        return None
    return np.concatenate([np.zeros((1, table.shape[1]), np.float32), table])[index]
