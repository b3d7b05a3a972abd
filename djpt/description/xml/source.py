"""The parser of XML text, whose elements know their line.

Features that could make a parser read other files or grow without bounds are refused: document types, entities,
deep nesting.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser

from djpt.core.files import read_bytes
from djpt.errors import SceneError

__all__ = ["MAX_NESTING", "Element", "Entry", "Node", "Reference", "parse", "parse_file"]

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
    parser = DefusedXMLParser(target=builder, forbid_dtd=True, forbid_entities=True, forbid_external=True)
    builder.expat = parser.parser
    try:
        parser.feed(text)
        root: Any = parser.close()
    except ParseError as error:
        line, column = error.position
        # Python's message ends with the position, which is in front here.
        problem = str(error).partition(": line ")[0]
        raise SceneError(f"{name}:{line}: not well-formed XML: {problem} (column {column + 1})") from None
    except DefusedXmlException:
        raise SceneError(f"{builder.place}: document types and entities aren't allowed in scene files") from None
    except SceneError:
        raise
    except (LookupError, UnicodeError, ValueError) as error:
        raise SceneError(f"{builder.place}: can't read the text: {error}") from None
    assert isinstance(root, Element)
    return root


class _Builder:
    """The tree builder that the parser reports to."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.expat: Any = None
        self.open: list[Element] = []
        self.root: Element | None = None

    @property
    def place(self) -> str:
        """File and line that the parser has reached."""
        return f"{self.name}:{self.expat.CurrentLineNumber}"

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, dict(attributes), self.place)
        if len(self.open) >= MAX_NESTING:
            raise element.error(f"nested deeper than {MAX_NESTING} levels")
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)

    def end(self, tag: str) -> None:
        self.open.pop()

    def data(self, text: str) -> None:
        """Ignore text between tags."""

    def close(self) -> Element:
        assert self.root is not None  # else the parser has raised already
        return self.root


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
