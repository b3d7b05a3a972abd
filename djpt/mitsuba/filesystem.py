"""Paths of files as Mitsuba has them; `pathlib` does the same, and every function of djpt takes either.

Functions return whether they succeeded, where Python's raise; only `file_size` raises.
"""

from __future__ import annotations

import os
import shutil
from typing import Any

from djpt.errors import FileError

__all__ = [
    "absolute",
    "copy_file",
    "create_directory",
    "current_path",
    "equivalent",
    "exists",
    "file_size",
    "is_directory",
    "is_regular_file",
    "path",
    "preferred_separator",
    "remove",
    "resize_file",
]

preferred_separator = os.sep
"""The separator between the parts of a path."""


class path(os.PathLike[str]):
    """The parts of a path, made of a string, of another path, or of nothing: an empty, relative one.

    Nothing is resolved: paths are equal if their parts are. Strings stand for paths.
    """

    def __init__(self, arg: str | os.PathLike[str] = "") -> None:
        text = os.fspath(arg)
        self._absolute = os.path.isabs(text)
        self._parts = [part for part in text.replace(os.sep, "/").split("/") if part]

    @classmethod
    def _of(cls, parts: list[str], absolute: bool) -> path:
        made = cls()
        made._parts, made._absolute = parts, absolute
        return made

    def clear(self) -> None:
        """Make the path empty."""
        self._parts, self._absolute = [], False

    def empty(self) -> bool:
        """Whether there are no parts."""
        return not self._parts

    def is_absolute(self) -> bool:
        """Whether the path begins at the root."""
        return self._absolute

    def is_relative(self) -> bool:
        """Whether the path doesn't begin at the root."""
        return not self._absolute

    def parent_path(self) -> path:
        """The path without its last part; ``..`` of an empty one."""
        if not self._parts and not self._absolute:
            return path("..")
        return path._of(self._parts[:-1], self._absolute)

    def filename(self) -> path:
        """The last part."""
        return path._of(self._parts[-1:], False)

    def _split(self) -> tuple[str, str]:
        """The last part before its last period, and from there on."""
        name = self._parts[-1] if self._parts else ""
        at = -1 if name in (".", "..") else name.rfind(".")
        return (name, "") if at < 0 else (name[:at], name[at:])

    def extension(self) -> path:
        """The last part from its last period on; empty if there is none."""
        return path(self._split()[1])

    def replace_extension(self, arg: str | os.PathLike[str], /) -> path:
        """Change the extension, with or without a period, and return the path itself; an empty one removes it."""
        stem, _ = self._split()
        extension = os.fspath(arg)
        if self._parts and self._parts[-1] not in (".", ".."):
            self._parts[-1] = stem + (extension if not extension or extension.startswith(".") else f".{extension}")
        return self

    def native(self) -> str:
        """The path as a string."""
        drive = len(self._parts) > 0 and self._parts[0].endswith(":")
        return (os.sep if self._absolute and not drive else "") + os.sep.join(self._parts)

    def __truediv__(self, arg: str | os.PathLike[str], /) -> path:
        other = path(arg)
        if other._absolute:
            raise FileError(f"'{other}' is absolute: it can't stand below '{self}'")
        return path._of(self._parts + other._parts, self._absolute)

    def __eq__(self, arg: object, /) -> bool:
        if not isinstance(arg, (str, os.PathLike)):
            return NotImplemented
        other = path(arg)
        return (self._parts, self._absolute) == (other._parts, other._absolute)

    def __hash__(self) -> int:
        return hash((tuple(self._parts), self._absolute))

    def __fspath__(self) -> str:
        return self.native()

    def __str__(self) -> str:
        return self.native()

    __repr__ = __str__


def current_path() -> path:
    """The working directory."""
    return path(os.getcwd())


def absolute(arg: Any, /) -> path:
    """The path from the root, without links and dots."""
    return path(os.path.realpath(os.fspath(arg) or "."))


is_regular_file = os.path.isfile
"""Whether there is a file."""
is_directory = os.path.isdir
"""Whether there is a folder."""
exists = os.path.exists
"""Whether there is anything."""


def file_size(arg: Any, /) -> int:
    """The size of a file in bytes; raises `FileError` if there is none."""
    try:
        return os.path.getsize(arg)
    except OSError as error:
        raise FileError(f"{os.fspath(arg)}: the size isn't known: {error.strerror}") from error


def equivalent(arg0: Any, arg1: Any, /) -> bool:
    """Whether two paths lead to the same file or folder, which has to exist."""
    return os.path.exists(arg0) and os.path.exists(arg1) and os.path.samefile(arg0, arg1)


def create_directory(arg: Any, /) -> bool:
    """Create a folder, unless it exists; true if it is there afterwards."""
    return _done(os.makedirs, arg, exist_ok=True)


def resize_file(arg0: Any, arg1: int, /) -> bool:
    """Cut a file to a size, or fill it up with zeros; false if that fails."""
    return _done(os.truncate, arg0, arg1)


def remove(arg: Any, /) -> bool:
    """Remove a file or an empty folder; false if that fails."""
    return _done(os.rmdir if os.path.isdir(arg) else os.remove, arg)


def copy_file(arg0: Any, arg1: Any, /) -> bool:
    """Copy a file to another path; false if that fails."""
    return _done(shutil.copyfile, arg0, arg1)


def _done(operation: Any, *arguments: Any, **options: Any) -> bool:
    """Whether an operation of Python succeeds."""
    try:
        operation(*arguments, **options)
    except OSError:
        return False
    return True
