"""The PLY container: a header that declares elements with properties, then their rows.

Reads ascii and binary files of both byte orders into columns. A reader of our own: `plyfile` walks over
ascii files and lists in Python, and names neither line nor byte when a file is cut short.

Greg Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

import struct
import warnings
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError, near_miss

__all__ = ["Column", "Element", "read_elements"]

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("long", "int64"), "i8"),
    **dict.fromkeys(("ulong", "uint64"), "u8"),
    **dict.fromkeys(("half", "float16"), "f2"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}

CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f8": "d"}
"""The codes of the module `struct` for the types that lengths of lists have here."""

COUNT = "length of "
"""Prefix of a list's length in the layout of rows; no property's name has blanks."""


@dataclass
class Property:
    """One declared property: a number per row, or a list of numbers."""

    name: str
    type: str
    """NumPy's code of the numbers, without byte order."""
    count_type: str | None = None
    """NumPy's code of a list's length; None if the property isn't a list."""


@dataclass
class Column:
    """The values of a property for all rows."""

    values: NDArray[Any]
    """One value per row; for lists all entries, one list after the other."""
    counts: NDArray[np.int64] | None = None
    """The length of each row's list; None if the property isn't a list."""


LONGEST_WORD = 40
"""The characters of a word of a file that messages show."""

DIGITS = 18
"""The digits of the largest number of rows that a header may declare."""


@dataclass
class Element:
    """Rows of one kind, such as ``vertex``."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)
    columns: dict[str, Column] = field(default_factory=dict)


def read_elements(data: bytes, where: str) -> list[Element]:
    """Read all elements of a file, with their columns.

    Args:
        data: the file's contents.
        where: names the file in messages.

    Raises:
        SceneError: not a PLY file, a header that can't be understood, a file that is cut short.
    """
    elements, order, body, line = read_header(data, where)
    rows = TextRows(data[body:], line, where) if order is None else Rows(data, body, order, where)
    for element in elements:
        if len({p.name for p in element.properties}) < len(element.properties):
            raise SceneError(f"{where}: the element '{element.name}' declares a property twice")
    try:
        for element in elements:
            if element.properties:
                rows.read(element)
    except SceneError:
        rows.explain(elements)
        raise
    if rows.is_left():
        rows.explain(elements)
    return elements


def read_header(data: bytes, where: str) -> tuple[list[Element], str | None, int, int]:
    """Read the header: the elements declared, the byte order (None: text), offset and line where the body begins."""
    if data[:3] != b"ply" or data[3:4] not in (b"\n", b"\r"):
        raise SceneError(f"{where}: not a PLY file: it doesn't begin with the line 'ply'")
    elements: list[Element] = []
    order: str | None = None
    known = False
    position, number = 0, 0
    while True:
        end = data.find(b"\n", position)
        if end < 0:
            raise SceneError(f"{where}, line {number + 1}: the file ends in its header: no line 'end_header'")
        words = data[position:end].decode("latin-1").split()
        position, number = end + 1, number + 1
        at = f"{where}, line {number}"
        if words == ["end_header"]:
            break
        if not words or words[0] in ("ply", "comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3:
            if words[1] not in ORDERS:
                raise SceneError(f"{at}: unknown format '{words[1][:LONGEST_WORD]}'{near_miss(words[1], ORDERS)}")
            order, known = ORDERS[words[1]], True
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal() and len(words[2]) <= DIGITS:
            elements.append(Element(words[1], int(words[2])))
        elif words[0] == "property" and elements and len(words) in (3, 5):
            elements[-1].properties.append(read_property(words, at))
        else:
            raise SceneError(f"{at}: can't understand this line of '{words[0][:LONGEST_WORD]}'")
    if not known:
        raise SceneError(f"{where}: the header has no line 'format'")
    return elements, order, position, number + 1


def read_property(words: list[str], at: str) -> Property:
    """Read a line ``property float x`` or ``property list uchar int vertex_indices``."""
    names = words[1:2] if len(words) == 3 else words[2:4]
    for name in names:
        if name not in TYPES:
            raise SceneError(f"{at}: unknown type '{name[:LONGEST_WORD]}'{near_miss(name, TYPES)}")
    if len(words) == 3:
        return Property(words[2], TYPES[words[1]])
    if words[1] != "list" or TYPES[words[2]][0] == "f":
        raise SceneError(f"{at}: a list is counted by whole numbers: property list uchar int NAME")
    return Property(words[4], TYPES[words[3]], TYPES[words[2]])


class Rows:
    """The body of a binary file, read element by element."""

    def __init__(self, data: bytes, position: int, order: str, where: str) -> None:
        self.data, self.position, self.order, self.where = data, position, order, where

    def read(self, element: Element) -> None:
        """Fill the element's columns."""
        lengths: dict[str, int] = {}
        if element.count and any(p.count_type for p in element.properties):
            # Lists nearly always have the same length: suppose so, and check it.
            lengths = self._lengths_at(element, self.position)
        layout = self._layout(element, lengths)
        end = self.position + layout.itemsize * element.count
        if end <= len(self.data):
            table = np.frombuffer(self.data, layout, element.count, self.position)
            if all((table[COUNT + name] == length).all() for name, length in lengths.items()):
                self.position = end
                for p in element.properties:
                    counts = np.full(element.count, lengths.get(p.name, 0)) if p.count_type else None
                    element.columns[p.name] = Column(table[p.name].ravel(), counts)
                return
        elif not lengths:
            self._cut_short(element, (len(self.data) - self.position) // layout.itemsize)
        self._walk(element)

    def is_left(self) -> bool:
        """Whether the file holds more than was declared, and that may be a mistake."""
        return False

    def explain(self, elements: list[Element]) -> None:
        """Raise a more exact error about a wrong file, if one is found."""

    def _type(self, code: str) -> str:
        """NumPy's code of numbers of a declared type, with their byte order."""
        return self.order + code

    def _length(self, value: float, element: Element, row: int) -> int:
        """The length of a list by the number before it."""
        if value < 0:
            self._cut_short(element, row)
        return int(value)

    def _layout(self, element: Element, lengths: dict[str, int]) -> np.dtype[np.void]:
        """The type of a row whose lists have the given lengths."""
        fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        for p in element.properties:
            if p.count_type:
                fields.append((COUNT + p.name, self._type(p.count_type)))
                fields.append((p.name, self._type(p.type), (lengths.get(p.name, 0),)))
            else:
                fields.append((p.name, self._type(p.type)))
        return np.dtype(fields)

    def _lengths_at(self, element: Element, position: int) -> dict[str, int]:
        """The lengths of the lists in the row that begins at `position`."""
        lengths = {}
        for p in element.properties:
            if p.count_type:
                counted = np.dtype(self._type(p.count_type))
                if position + counted.itemsize > len(self.data):
                    self._cut_short(element, 0)
                lengths[p.name] = self._length(np.frombuffer(self.data, counted, 1, position)[0], element, 0)
                position += counted.itemsize
            position += np.dtype(self._type(p.type)).itemsize * lengths.get(p.name, 1)
        if position > len(self.data):
            self._cut_short(element, 0)
        return lengths

    def _walk(self, element: Element) -> None:
        """Read rows one by one: their lists differ in length."""
        parts: dict[str, list[bytes]] = {p.name: [] for p in element.properties}
        counts: dict[str, list[int]] = {p.name: [] for p in element.properties if p.count_type}
        data, position, total = self.data, self.position, len(self.data)
        plan = []
        for p in element.properties:
            counted = np.dtype(self._type(p.count_type)) if p.count_type else None
            number = struct.Struct(counted.str[0].replace("|", "<") + CODES[counted.str[1:]]) if counted else None
            plan.append((p.name, np.dtype(self._type(p.type)).itemsize, number))
        for row in range(element.count):
            for name, size, number in plan:
                if number is not None:
                    inside = position + number.size <= total
                    count = self._length(number.unpack_from(data, position)[0], element, row) if inside else 0
                    counts[name].append(count)
                    position, size = position + number.size, size * count
                parts[name].append(data[position : position + size])
                position += size
            if position > total:
                self._cut_short(element, row)
        self.position = position
        for p in element.properties:
            values = np.frombuffer(b"".join(parts[p.name]), self._type(p.type))
            element.columns[p.name] = Column(values, np.array(counts[p.name]) if p.count_type else None)

    def _cut_short(self, element: Element, row: int) -> NoReturn:
        raise SceneError(
            f"{self.where}, {self._end()}: the file is cut short, in row {row} of {element.count} "
            f"of the element '{element.name}'"
        )

    def _end(self) -> str:
        return f"byte {len(self.data)}"


class TextRows(Rows):
    """An ascii body: numbers, wherever lines end. As doubles they are a binary body."""

    def __init__(self, text: bytes, line: int, where: str) -> None:
        self.text, self.line, self.where = text, line, where
        super().__init__(self._numbers().tobytes(), 0, "<", where)

    def _numbers(self) -> NDArray[np.float64]:
        with warnings.catch_warnings():
            # Text that isn't numbers is a deprecation warning in NumPy, an error in later versions.
            warnings.simplefilter("error")
            try:
                return np.fromstring(self.text.decode("latin-1"), np.float64, sep=" ")
            except (DeprecationWarning, ValueError):
                pass
        for number, line in enumerate(self.text.split(b"\n"), self.line):
            for word in line.split():
                try:
                    float(word)
                except ValueError:
                    found = word.decode("latin-1")[:40]
                    raise SceneError(f"{self.where}, line {number}: '{found}' isn't a number") from None
        # Python accepts a few spellings that NumPy doesn't, such as 1_000.
        return np.array(self.text.split(), np.float64)

    def _type(self, code: str) -> str:
        return "<f8"

    def _length(self, value: float, element: Element, row: int) -> int:
        if not (value >= 0 and value.is_integer()):
            raise SceneError(f"{self.where}: row {row} of the element '{element.name}' has a list of {value:g} entries")
        return int(value)

    def is_left(self) -> bool:
        return self.position < len(self.data)

    def explain(self, elements: list[Element]) -> None:
        # Usually each row has a line of its own: the first of another length is the wrong one.
        lines = [(n, line.split()) for n, line in enumerate(self.text.split(b"\n"), self.line) if line.split()]
        rows = ((element, row) for element in elements for row in range(element.count))
        for (number, words), (element, row) in zip(lines, rows, strict=False):
            wanted = 0
            for p in element.properties:
                length = words[wanted] if p.count_type and wanted < len(words) else b"0"
                wanted += 1 + (int(length) if length.isdigit() else 0) if p.count_type else 1
            if wanted != len(words):
                raise SceneError(
                    f"{self.where}, line {number}: row {row} of the element '{element.name}' should have "
                    f"{wanted} numbers, found {len(words)}"
                )

    def _end(self) -> str:
        last = self.line + self.text.rstrip().count(b"\n")
        return f"line {last}"
