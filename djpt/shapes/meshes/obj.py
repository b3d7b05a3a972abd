"""The reader of meshes in Wavefront OBJ files.

A reader of our own on NumPy: vertices must be merged and numbered as in Mitsuba (one for each distinct
combination of indices, in the order of first use), and errors must name the line, which libraries for
many formats do not offer.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.meshes.polygons import fans

__all__ = ["read_obj"]

KINDS = ("v", "vt", "vn", "f")
NAMES = ("vertex", "texture coordinate", "normal")
LEAST = {"v": 3, "vt": 2, "vn": 3, "f": 0}
"""How many numbers a line of each kind must have; further ones are ignored (colours, weights)."""

Lines = dict[str, list[bytes]]
LineNumbers = dict[str, list[int]]


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
    lines, numbers = split_lines(data)
    tables = {kind: read_numbers(lines, numbers, kind, where) for kind in ("v", "vt", "vn")}
    corners = read_corners(lines, numbers, where)
    sizes = [len(tables[kind]) for kind in ("v", "vt", "vn")]
    resolve_negative(corners, numbers)
    check_range(corners, sizes, numbers, where)
    keys, own = first_use(corners.keys, sizes)
    positions = tables["v"][keys[:, 0] - 1]
    texcoords = pick(tables["vt"], keys[:, 1])
    normals = pick(tables["vn"], keys[:, 2])
    triangles, _ = fans(corners.counts)
    return MeshData(positions, own[triangles].astype(np.uint32), normals, texcoords)


def split_lines(data: bytes) -> tuple[Lines, LineNumbers]:
    """Sort the lines that matter by kind, without the keyword, and tell their line numbers."""
    data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\t", b" ")
    all_lines = data.split(b"\n")
    if b"\\\n" in data:
        # A backslash joins lines; an empty line stays behind, so that the numbers of later lines are right.
        for i in reversed(range(len(all_lines) - 1)):
            if all_lines[i].endswith(b"\\"):
                all_lines[i], all_lines[i + 1] = all_lines[i][:-1] + b" " + all_lines[i + 1], b""
    lines: Lines = {kind: [] for kind in KINDS}
    numbers: LineNumbers = {kind: [] for kind in KINDS}
    for number, line in enumerate(all_lines, 1):
        keyword, _, rest = line.partition(b" ")
        if not keyword:
            keyword, _, rest = line.lstrip().partition(b" ")
        kind = KEYWORDS.get(keyword)
        if kind:
            lines[kind].append(rest.partition(b"#")[0] if b"#" in rest else rest)
            numbers[kind].append(number)
    return lines, numbers


KEYWORDS = {kind.encode(): kind for kind in KINDS}


def read_numbers(lines: Lines, numbers: LineNumbers, kind: str, where: str) -> NDArray[np.float32]:
    """Read the first two or three numbers of each line of a kind, (N, 2) or (N, 3)."""
    rows, least = lines[kind], LEAST[kind]
    if not rows:
        return np.zeros((0, least), np.float32)
    widths = {len(row.split()) for row in rows}
    if len(widths) == 1 and min(widths) >= least:
        flat = parse(b" ".join(rows), np.float64)
        if flat is not None and len(flat) == len(rows) * min(widths):
            with np.errstate(over="ignore"):
                return flat.reshape(len(rows), -1)[:, :least].astype(np.float32)
    result = np.empty((len(rows), least), np.float32)
    for i, row in enumerate(rows):
        words = row.split()[:least]
        try:
            if len(words) < least:
                raise ValueError
            result[i] = [float(word) for word in words]
        except ValueError:
            found = row.decode("latin-1").strip()[:60]
            at = f"{where}, line {numbers[kind][i]}"
            raise SceneError(f"{at}: '{kind}' must be followed by {least} numbers, found '{found}'") from None
    return result


def parse(text: bytes, dtype: type[np.generic]) -> NDArray[Any] | None:
    """Parse numbers separated by blanks; None if there is anything else."""
    with warnings.catch_warnings():
        # Text that isn't numbers is a deprecation warning in NumPy, an error in later versions.
        warnings.simplefilter("error")
        try:
            return np.fromstring(text.decode("latin-1"), dtype, sep=" ")
        except (DeprecationWarning, ValueError, OverflowError):
            return None


def read_corners(lines: Lines, numbers: LineNumbers, where: str) -> Corners:
    """Read the corners of all faces: ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn`` each."""
    rows = lines["f"]
    if not rows:
        return Corners(np.zeros((0, 3), np.int64), np.zeros(0, np.int64))
    counts = np.fromiter((len(row.split()) for row in rows), np.int64, len(rows))
    text = b" " + b" ".join(rows).replace(b"//", b"/0/")
    characters = np.frombuffer(text, np.uint8)
    # A corner begins after a blank; the slashes up to the next one belong to it.
    starts = (characters[:-1] == ord(" ")) & (characters[1:] != ord(" "))
    corner = np.cumsum(starts)
    slashes = np.bincount(corner[characters[1:] == ord("/")] - 1, minlength=int(counts.sum()))
    flat = parse(text.replace(b"/", b" "), np.int64)
    if flat is None or slashes.max(initial=0) > 2 or len(flat) != int((slashes + 1).sum()) or b"/ " in text + b" ":
        find_bad_face(rows, numbers["f"], where)
    assert flat is not None
    first = np.cumsum(slashes + 1) - (slashes + 1)
    keys = np.zeros((len(slashes), 3), np.int64)
    for k in range(3):
        has = slashes >= k
        keys[has, k] = flat[first[has] + k]
    return Corners(keys, counts)


def find_bad_face(rows: list[bytes], numbers: list[int], where: str) -> None:
    """Raise the error for the first face that can't be understood."""
    for row, number in zip(rows, numbers, strict=True):
        for word in row.split():
            parts = word.split(b"/")
            fine = len(parts) <= 3 and all(part.removeprefix(b"-").isdigit() for part in parts[:1] + parts[-1:])
            if not fine or (len(parts) == 3 and parts[1] and not parts[1].removeprefix(b"-").isdigit()):
                found = word.decode("latin-1")[:40]
                raise SceneError(
                    f"{where}, line {number}: can't understand the corner '{found}' of a face; "
                    "possible: v, v/vt, v//vn, v/vt/vn with whole numbers"
                )
    raise SceneError(f"{where}: a face has numbers that can't be read")


def resolve_negative(corners: Corners, numbers: LineNumbers) -> None:
    """Turn negative indices, of which -1 is the last entry before the face, into counts from 1, in place."""
    for k, kind in enumerate(("v", "vt", "vn")):
        negative = np.flatnonzero(corners.keys[:, k] < 0)
        if len(negative):
            line = np.repeat(np.array(numbers["f"]), corners.counts)[negative]
            before = np.searchsorted(np.array(numbers[kind]), line)
            value = corners.keys[negative, k] + before + 1
            # An index before the first entry must not turn into 0, which means none.
            corners.keys[negative, k] = np.where(value > 0, value, -1)


def check_range(corners: Corners, sizes: list[int], numbers: LineNumbers, where: str) -> None:
    """Raise `SceneError` for the first reference to something that doesn't exist."""
    keys = corners.keys
    bad = (keys < 0) | (keys > np.array(sizes))
    bad[:, 0] |= keys[:, 0] == 0
    if not bad.any():
        return
    row = int(np.argmax(bad.any(axis=1)))
    k = int(np.argmax(bad[row]))
    line = int(np.repeat(np.array(numbers["f"]), corners.counts)[row])
    number = "0" if keys[row, k] == 0 else f"{keys[row, k]}" if keys[row, k] > 0 else "before the first"
    have = f"there are {sizes[k]}, counted from 1" if sizes[k] else "there is none"
    raise SceneError(f"{where}, line {line}: a face refers to the {NAMES[k]} {number}; {have}")


def first_use(keys: NDArray[np.int64], sizes: list[int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The distinct keys in the order of first use, (V, 3), and for each corner the number of its key."""
    if not keys[:, 1:].any():
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
