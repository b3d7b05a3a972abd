"""Scene descriptions that know the file they come from."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

__all__ = ["Document", "files_of", "named_files", "with_files"]


class Document(dict[str, Any]):
    """The dict of a scene file: an ordinary description, whose errors name the file and the line.

    Args:
        description: the description.
        name: the scene's name, for messages and output files.
        places: file and line by path: of nodes (``sensor.film``; the root is the empty path) and of
            their entries (``sensor.film.width``).
        directories: where relative names of files are looked up, besides the working directory.
        root: the directory that an untrusted scene may not leave, or None.
    """

    def __init__(
        self,
        description: Mapping[str, Any],
        name: str = "scene",
        places: Mapping[str, str] | None = None,
        directories: tuple[Path, ...] = (),
        root: Path | None = None,
    ) -> None:
        super().__init__(description)
        self.name = name
        self.places = dict(places or {})
        self.directories = directories
        self.root = root

    def copy(self) -> Document:
        """A shallow copy that keeps the name, the places and the directories."""
        return Document(self, self.name, self.places, self.directories, self.root)


# ---- the files that a description names ------------------------------------------------------


def named_files(description: Mapping[str, Any]) -> dict[str, Path]:
    """The files that nodes name by ``filename``, by that name; names without a file are left out."""
    folders = (Path(), *(description.directories if isinstance(description, Document) else ()))
    found = {}
    for name in of(description):
        places = [folder / name for folder in folders if (folder / name).is_file()]
        if places:
            found[name] = places[0]
    return found


def files_of(description: Mapping[str, Any]) -> list[Path]:
    """The files that a description came from, and those that its nodes name; none for a dict that names none."""
    places = description.places.values() if isinstance(description, Document) else ()
    written = [Path(place.rpartition(":")[0]) for place in places]
    return [path for path in dict.fromkeys([*written, *named_files(description).values()]) if path.is_file()]


def with_files(description: Mapping[str, Any], files: Mapping[str, str]) -> dict[str, Any]:
    """A copy of a description that names other files in place of some."""
    result = description.copy() if isinstance(description, Document) else dict(description)
    for key, value in description.items():
        if isinstance(value, Mapping):
            result[key] = with_files(value, files)
        elif key == "filename" and isinstance(value, (str, os.PathLike)):
            result[key] = files.get(os.fspath(value), value)
    return result


def of(node: Mapping[str, Any]) -> Iterator[str]:
    """The values of ``filename`` in a description."""
    for key, value in node.items():
        if isinstance(value, Mapping):
            yield from of(value)
        elif key == "filename" and isinstance(value, (str, os.PathLike)):
            yield os.fspath(value)
