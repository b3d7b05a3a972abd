"""The search for files that a scene description names."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path

from djpt.errors import FileError

__all__ = ["FileResolver", "resolve"]


class FileResolver:
    """Directories in which relative names are looked up, in order; the working directory comes last."""

    def __init__(self, directories: Sequence[Path] = ()) -> None:
        self.directories = tuple(directories)

    def resolve(self, name: str) -> Path:
        """The file or directory called `name`.

        Raises:
            FileError: it is in none of the directories.
        """
        places = [*self.directories, Path.cwd()]
        for place in places:
            candidate = place / name
            with contextlib.suppress(OSError, ValueError):
                if candidate.exists():
                    return candidate
        if Path(name).is_absolute():
            raise FileError(f"'{name}' doesn't exist")
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
