"""The folder of a model: no file outside of it is read, whatever names a file has."""

from __future__ import annotations

import os
from pathlib import Path

from djpt.core.files import open_regular, read_bytes, shortened
from djpt.errors import FileError

__all__ = ["LARGEST_FILE", "Folder"]

LARGEST_FILE = 2**30
"""The bytes of the largest file that is read."""


class Folder:
    """Where a model's files are looked up.

    Args:
        path: the folder.
        root: the folder that no file may lie outside of, links resolved; default: `path`.
    """

    def __init__(self, path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> None:
        self.path = os.path.realpath(path)
        self.root = self.path if root is None else os.path.realpath(root)
        self.files: list[Path] = []
        """The files that were read."""

    def contains(self, path: str | os.PathLike[str]) -> bool:
        """True if a file lies in the root."""
        return os.path.commonpath([self.root, os.path.realpath(path)]) == self.root

    def find(self, name: str) -> Path:
        """The file called `name`, relative to the folder; raises `FileError` if it isn't there."""
        name = name.replace("\\", "/")
        if not name or "\0" in name or "://" in name:
            raise FileError(f"'{shortened(name)}' isn't the name of a file")
        real = os.path.realpath(os.path.join(self.path, name))
        if not self.contains(real):
            raise FileError(f"'{shortened(name)}' isn't in '{self.root}', which a model may not leave")
        if not os.path.exists(real):
            raise FileError(f"'{shortened(name)}' doesn't exist in '{self.path}'")
        return Path(real)

    def read(self, name: str) -> bytes:
        """The contents of a file.

        Raises:
            FileError: it is outside of the folder, doesn't exist, or has more than `LARGEST_FILE` bytes.
        """
        path = self.find(name)
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
        if size > LARGEST_FILE:
            raise FileError(f"'{shortened(name)}' has {size} bytes; at most {LARGEST_FILE}")
        self.files.append(path)
        return read_bytes(path)
