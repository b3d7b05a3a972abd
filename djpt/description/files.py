"""The search for files that a scene description names, and what is read from them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Collection, Hashable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

from djpt.errors import FileError

__all__ = ["FileResolver", "read_once", "reading_once", "resolve"]

T = TypeVar("T")


class FileResolver:
    """Directories in which relative names are looked up, in order; the working directory comes last."""

    def __init__(self, directories: Sequence[Path] = ()) -> None:
        self.directories = tuple(directories)
        self._places = [str(directory) for directory in self.directories]

    def resolve(self, name: str) -> Path:
        """The file or directory called `name`.

        Raises:
            FileError: it is in none of the directories.
        """
        # Texts: hundreds of names are looked up, and paths take ten times as long.
        for place in self._places:
            if os.path.exists(candidate := os.path.join(place, name)):
                return Path(candidate)
        if os.path.exists(name):
            return Path.cwd() / name
        if Path(name).is_absolute():
            raise FileError(f"'{name}' doesn't exist")
        places = [*self.directories, Path.cwd()]
        raise FileError(f"'{name}' doesn't exist; searched: {', '.join(str(place) for place in places)}")

    @contextlib.contextmanager
    def active(self) -> Iterator[None]:
        """Make `resolve` use this resolver within a ``with`` block."""
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)


_current: ContextVar[FileResolver | None] = ContextVar("file_resolver", default=None)


def resolve(name: str) -> Path:
    """The path of a file that is named by the description being loaded; raises `FileError`."""
    return (_current.get() or FileResolver()).resolve(name)


# ---- what is read --------------------------------------------------------------------------


@contextlib.contextmanager
def reading_once(names: Collection[str]) -> Iterator[None]:
    """Keep what is read from the files of these names until the end of a ``with`` block: see `read_once`.

    `names` are those that a description has several times. What is read from other files isn't needed again.
    """
    token = _kept.set({name: {} for name in names})
    try:
        yield
    finally:
        _kept.reset(token)


_kept: ContextVar[dict[str, dict[Hashable, Any]] | None] = ContextVar("kept", default=None)


def read_once(name: str, form: Hashable, read: Callable[[], T]) -> T:
    """What `read` gives or, if the file `name` was read before in the same `form`, what it gave then.

    Results may be shared, so they must not be changed.
    """
    known = (_kept.get() or {}).get(name)
    if known is None:
        return read()
    if form not in known:
        known[form] = read()
    result: T = known[form]
    return result
