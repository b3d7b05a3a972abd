"""The parser of XML text, whose elements know their line.

Features that could make a parser read other files or grow without bounds are refused: document types, entities,
deep nesting.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn
from xml.parsers import expat

from djpt.core.files import read_bytes
from djpt.core.limits import LARGEST
from djpt.description.files import NUMBER, read_pairs
from djpt.errors import FileError, SceneError, near_miss

__all__ = [
    "MAX_NESTING",
    "VALUES",
    "Element",
    "Entry",
    "Node",
    "Reference",
    "check_attributes",
    "number",
    "numbers",
    "parse",
    "parse_file",
    "spectrum_file",
    "vector",
]

MAX_NESTING = 64
"""Deepest nesting of elements. Real scenes need about six levels."""


@dataclass(eq=False)
class Element:
    """A tag, its attributes and nested elements. `place` is ``file:line``. Text is dropped, as in Mitsuba."""

    tag: str
    attributes: dict[str, str]
    place: str
    children: list[Element] = field(default_factory=list)

    def error(self, problem: str) -> SceneError:
        """Make the error to raise: ``box.xml:12: <float>: the problem``."""
        return SceneError(f"{self.place}: <{self.tag}>: {problem}")


def parse_file(path: Path) -> Element:
    """Parse a file into its root element.

    Raises:
        FileError: the file can't be read.
        SceneError: it isn't well-formed XML, or has a feature that is refused.
    """
    return parse(read_bytes(path), str(path))


def parse(text: str | bytes, name: str) -> Element:
    """Parse a text into its root element; `name` is the file's name in messages. Raises `SceneError`."""
    builder = _Builder(name)
    try:
        builder.expat.Parse(text, True)
    except expat.ExpatError as error:
        # Python's message ends with the position, which is in front here.
        problem = str(error).partition(": line ")[0]
        raise SceneError(f"{name}:{error.lineno}: not well-formed XML: {problem} (column {error.offset + 1})") from None
    except SceneError:
        raise
    except (LookupError, UnicodeError, ValueError) as error:
        raise SceneError(f"{builder.place}: can't read the text: {error}") from None
    assert builder.root is not None  # else the parser has raised
    return builder.root


class _Builder:
    """The tree builder that the parser `expat` reports to."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.open: list[Element] = []
        self.root: Element | None = None
        self.expat = expat.ParserCreate()
        self.expat.StartElementHandler = self.start
        self.expat.EndElementHandler = self.end
        # Entities can only be declared in a document type, so none is ever expanded, nor any other file read.
        self.expat.StartDoctypeDeclHandler = self.refuse
        self.expat.EntityDeclHandler = self.refuse
        self.expat.ExternalEntityRefHandler = self.refuse

    @property
    def place(self) -> str:
        """File and line that the parser has reached."""
        return f"{self.name}:{self.expat.CurrentLineNumber}"

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, self.place)
        if len(self.open) >= MAX_NESTING:
            raise element.error(f"nested deeper than {MAX_NESTING} levels")
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)

    def end(self, tag: str) -> None:
        self.open.pop()

    def refuse(self, *_: Any) -> NoReturn:
        """Raise `SceneError` for what could name other files, or grow without bounds."""
        raise SceneError(f"{self.place}: document types and entities aren't allowed in scene files")


# ---- nodes, before names and references are resolved -----------------------------------------


@dataclass(frozen=True)
class Reference:
    """A ``<ref>``: the name that it refers to."""

    id: str


@dataclass(eq=False)
class Entry:
    """Something nested in an object: a value, a `Node` or a `Reference`, with or without a name."""

    name: str
    value: Any
    place: str


@dataclass(eq=False)
class Node:
    """An object of a scene file: its `tag` (``bsdf``), its plugin's `type`, and its `place` (file and line)."""

    tag: str
    type: str
    id: str
    place: str
    entries: list[Entry] = field(default_factory=list)
    places: dict[str, str] = field(default_factory=dict)
    """File and line of each named entry."""

    def find(self, name: str) -> Entry | None:
        """The entry of that name."""
        return next((entry for entry in self.entries if entry.name == name), None)

    def add(self, name: str, value: Any, element: Element) -> None:
        """Append an entry for `element`; an empty `name` means none.

        Raises:
            SceneError: the name can't be used, or is taken.
        """
        if name in ("type", "id"):
            raise element.error(f"the name '{name}' can't be used: write <{self.tag} {name}=\"...\">")
        if "." in name:
            raise element.error(f"the name '{name}' contains a '.', which separates the parts of a path")
        self.append(Entry(name, value, element.place))

    def append(self, entry: Entry) -> None:
        """Append an entry; raise `SceneError` if its name is taken."""
        if entry.name and self.places.setdefault(entry.name, entry.place) is not entry.place:
            raise SceneError(f"{entry.place}: '{entry.name}' was already given ({self.places[entry.name]})")
        self.entries.append(entry)


# ---- value tags: numbers, vectors, colours, spectra ------------------------------------------


_FLOAT = re.compile(NUMBER, re.ASCII)
_PLAIN = re.compile(r"[-+.eE:,\s\d]*", re.ASCII)
"""The characters of pairs of numbers; what Python takes for numbers is written in others as well (nan, 1_000)."""
_INTEGER = re.compile(r"[+-]?\d{1,19}", re.ASCII)
_SEPARATORS = re.compile(r"[,\s]+")


def check_attributes(element: Element, required: str = "", optional: str = "") -> None:
    """Raise `SceneError` for an attribute that is missing or unknown. Names are separated by spaces."""
    possible = [*required.split(), *optional.split()]
    for name in element.attributes:
        if name not in possible:
            raise element.error(f"unknown attribute '{name}'{near_miss(name, possible)}")
    for name in required.split():
        if name not in element.attributes:
            found = ", ".join(element.attributes) or "none"
            raise element.error(f"the attribute '{name}' is missing (found: {found})")


def number(element: Element, text: str) -> float:
    """Parse a finite number."""
    if not _FLOAT.fullmatch(text.strip()):
        raise element.error(f"must be a number, found '{text}'")
    value = float(text)
    if abs(value) > LARGEST:
        raise element.error(f"must be finite in single precision, found '{text}'")
    return value


def numbers(element: Element, text: str) -> list[float]:
    """Parse numbers that are separated by spaces or commas."""
    return [number(element, part) for part in _SEPARATORS.split(text) if part]


def vector(element: Element, default: float | None, extra: str = "") -> list[float]:
    """Parse the attributes ``x``, ``y``, ``z``, or ``value`` with three numbers or one for all.

    `default` stands for a missing component (None: all must be there); `extra` names further
    attributes, which are required.
    """
    if "value" in element.attributes:
        check_attributes(element, f"value {extra}")
        found = numbers(element, element.attributes["value"])
        if len(found) not in (1, 3):
            raise element.error(f"'value' must be one or three numbers, found {len(found)}")
        return found * 3 if len(found) == 1 else found
    if default is None:
        check_attributes(element, f"{extra} x y z")
    else:
        check_attributes(element, extra, "x y z value")
    texts = [element.attributes.get(axis) for axis in "xyz"]
    return [default or 0.0 if text is None else number(element, text) for text in texts]


# ---- one function per tag: its entry in the dict -------------------------------------------


def _integer(element: Element) -> int:
    text = element.attributes["value"]
    if not _INTEGER.fullmatch(text.strip()):
        raise element.error(f"must be a whole number, found '{text}'")
    return int(text)


def _boolean(element: Element) -> bool:
    text = element.attributes["value"].lower()
    if text not in ("true", "false"):
        raise element.error(f"must be true or false, found '{element.attributes['value']}'")
    return text == "true"


def _rgb(element: Element) -> dict[str, Any]:
    found = numbers(element, element.attributes["value"])
    if len(found) not in (1, 3):
        raise element.error(f"must be one or three numbers, found {len(found)}: '{element.attributes['value']}'")
    return {"type": "rgb", "value": found * 3 if len(found) == 1 else found}


def _spectrum(element: Element) -> dict[str, Any]:
    text = element.attributes["value"]
    parts = [part for part in _SEPARATORS.split(text) if part]
    if len(parts) == 1 and ":" not in text:
        return {"type": "spectrum", "value": number(element, parts[0])}
    pairs = _plain_pairs(text, parts) or [_pair(element, part) for part in parts]
    _check_pairs(element, pairs)
    return {"type": "spectrum", "value": pairs}


def _plain_pairs(text: str, parts: list[str]) -> list[tuple[float, float]] | None:
    """Parse pairs of numbers at once; None if there is anything to say about them."""
    if not _PLAIN.fullmatch(text):
        return None
    try:
        pairs = [(float(wavelength), float(value)) for wavelength, value in (part.split(":") for part in parts)]
    except ValueError:
        return None
    return pairs if all(max(abs(a), abs(b)) <= LARGEST for a, b in pairs) else None


def _pair(element: Element, text: str) -> tuple[float, float]:
    """Parse a wavelength and a value."""
    wavelength, colon, value = text.partition(":")
    if not colon:
        raise element.error(f"must be one number or pairs such as '400:0.1, 700:0.2', found '{text}'")
    return number(element, wavelength), number(element, value)


def spectrum_file(element: Element, path: Path) -> dict[str, Any]:
    """Read the spectrum in a text file: a wavelength in nm and a value per line, ``#`` for comments."""
    try:
        pairs = list(zip(*read_pairs(path), strict=True))
    except FileError as error:
        raise element.error(str(error)) from None
    _check_pairs(element, pairs)
    return {"type": "spectrum", "value": pairs}


def _check_pairs(element: Element, pairs: list[tuple[float, float]]) -> None:
    if len(pairs) < 2:
        raise element.error(f"a spectrum needs at least two wavelengths, found {len(pairs)}")
    for (before, _), (after, _) in pairwise(pairs):
        if after <= before:
            raise element.error(f"wavelengths must increase, found {after:g} after {before:g}")


def _vector(element: Element) -> list[float]:
    return vector(element, None, "name")


def _with_value(read: Callable[[Element], Any]) -> Callable[[Element], Any]:
    """Wrap the function of a tag that has a name and a value and nothing else."""

    def checked(element: Element) -> Any:
        check_attributes(element, "name value")
        return read(element)

    return checked


VALUES: dict[str, Callable[[Element], Any]] = {
    "boolean": _with_value(_boolean),
    "integer": _with_value(_integer),
    "float": _with_value(lambda element: number(element, element.attributes["value"])),
    "string": _with_value(lambda element: element.attributes["value"]),
    "rgb": _with_value(_rgb),
    "spectrum": _with_value(_spectrum),
    "point": _vector,
    "vector": _vector,
}
"""The function of each tag, which gives the entry in the dict; raises `SceneError` with the element's place."""
