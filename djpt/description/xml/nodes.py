"""The nodes of a scene file, before names and references are resolved."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from djpt.description.xml.source import Element
from djpt.errors import SceneError

__all__ = ["Entry", "Node", "Reference"]


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
