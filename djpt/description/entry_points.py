"""Plugins of installed packages, found by entry points: their names and kinds are known without an import.

A package lists its plugins in its ``pyproject.toml``, with the module that registers each when it is imported::

    [project.entry-points."djpt.plugins"]
    "bsdf.chalk" = "chalk_and_cheese.chalk"
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from djpt.errors import SceneError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = ["GROUP", "Entry", "entries", "load"]

GROUP = "djpt.plugins"
"""The group of entry points that packages list their plugins in."""


@dataclass(frozen=True)
class Entry:
    """The `kind` and `name` of a plugin, the entry `point` of the module that registers it, and its `distribution`."""

    kind: str
    name: str
    point: EntryPoint
    distribution: str

    def __str__(self) -> str:
        return f"the entry point '{self.point.name} = {self.point.value}' of the package '{self.distribution}'"


def entries() -> dict[str, Entry]:
    """The entries of all packages that can be imported now, by the plugin's name.

    Raises:
        SceneError: An entry isn't called ``kind.name``, or two packages have a plugin of one name.
    """
    return found_on(tuple(sys.path))


@functools.cache
def found_on(path: Sequence[str]) -> dict[str, Entry]:
    """`entries` of the packages on a search path, which is read once."""
    # Takes as long to import as all else that a small scene needs; most sessions never ask.
    from importlib.metadata import distributions

    found: dict[str, Entry] = {}
    for distribution in distributions(path=list(path)):
        for point in distribution.entry_points.select(group=GROUP):
            kind, _, name = point.name.partition(".")
            entry = Entry(kind, name, point, distribution.name)
            if not (kind.isidentifier() and name):
                raise SceneError(
                    f"the package '{entry.distribution}' has an entry point '{point.name}' in the group '{GROUP}'; "
                    "expected a kind and a name, such as 'bsdf.chalk'"
                )
            # The first on the path hides others of its name, as with imports.
            if found.setdefault(name, entry).distribution != entry.distribution:
                raise SceneError(f"two packages have a plugin '{name}': {found[name]}, and {entry}")
    return found


def load(entry: Entry) -> None:
    """Import the module of an entry, which registers its plugin.

    Raises:
        SceneError: It can't be imported.
    """
    try:
        entry.point.load()
    except Exception as error:
        raise SceneError(f"{entry} can't be imported: {type(error).__name__}: {error}") from error
