"""Merging of nodes that are described alike, as by Mitsuba's loader if it is told to optimise."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any

from djpt.description.plugin import Plugin

__all__ = ["Merging"]

APART = ("shape", "emitter")
"""The kinds of plugins of which each stays itself, however alike their descriptions are."""


@dataclass
class Merging:
    """The plugins that a loader has built from descriptions, and which of them are alike.

    Mitsuba makes one object of all nodes of equal type and equal entries; their names don't count. Here each node
    stays a plugin of its own, and `alike` tells which would have been one.
    """

    keys: set[str] = field(default_factory=set)
    """The keys of a scene's entries that are described, rather than plugins that existed before."""
    first: dict[int, int] = field(default_factory=dict)
    """By the `id()` of a plugin, that of the first one that is described alike."""
    known: dict[Hashable, int] = field(default_factory=dict)
    """The first plugin of each description."""

    def note(self, plugin: Plugin, type_name: str, values: Mapping[str, Any]) -> None:
        """Note a plugin that was built from a node of this type with these entries, nested plugins among them."""
        if plugin.kind not in APART:
            entries = frozenset((key, self.content(value)) for key, value in values.items())
            self.first[id(plugin)] = self.known.setdefault((type_name, entries), id(plugin))

    def content(self, value: Any) -> Hashable:
        """A key that equal entries share. Arrays and other objects are equal to themselves alone."""
        if isinstance(value, Plugin):
            return Plugin, self.alike(value)
        if isinstance(value, (bool, int, float, str)):
            return type(value), value
        if isinstance(value, (list, tuple)):
            return tuple, tuple(map(self.content, value))
        return object, id(value)

    def alike(self, plugin: Any) -> int:
        """A number that a plugin shares with those that are described alike."""
        return self.first.get(id(plugin), id(plugin))
