"""Scene descriptions that know the file they come from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["Document"]


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
