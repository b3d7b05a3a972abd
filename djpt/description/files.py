"""The search for files that a scene description names, and descriptions that know the file they come from."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

from djpt.core.files import as_path, read_bytes, shortened
from djpt.core.limits import LARGEST
from djpt.errors import FileError

__all__ = [
    "NUMBER",
    "Document",
    "FileResolver",
    "confined",
    "file_resolver",
    "files_of",
    "named_files",
    "read_once",
    "read_pairs",
    "reading_once",
    "resolve",
    "set_file_resolver",
    "with_files",
]

T = TypeVar("T")


class FileResolver:
    """Directories in which relative names are looked up, in order; the working directory comes last.

    Args:
        directories: the directories, or another resolver whose directories are copied; default: the working
            directory.
        root: a directory that no file may lie outside of, links resolved, or None. What is outside isn't found.

    Raises:
        FileError: they aren't names.
    """

    def __init__(
        self,
        directories: Iterable[str | os.PathLike[str]] | None = None,
        root: str | os.PathLike[str] | None = None,
    ) -> None:
        try:
            self.directories = [working_directory()] if directories is None else [as_path(x) for x in directories]
        except TypeError:
            raise FileError(f"a FileResolver takes directories, found {type(directories).__name__}") from None
        self.root = None if root is None else os.path.realpath(as_path(root))

    def find(self, name: str | os.PathLike[str]) -> Path:
        """The file or directory called `name`.

        Raises:
            FileError: it is in none of the directories.
        """
        for place in self._places():
            # Texts: hundreds of names are looked up, and paths take ten times as long.
            if os.path.exists(candidate := os.path.join(place, name)) and self.allows(candidate):
                return Path(candidate)
        if self.root is not None:
            raise FileError(f"'{shortened(name)}' isn't in '{self.root}', which this scene may not leave")
        if Path(name).is_absolute():
            raise FileError(f"'{shortened(name)}' doesn't exist")
        searched = ", ".join(dict.fromkeys(str(place) for place in self._places()))
        raise FileError(f"'{shortened(name)}' doesn't exist; searched: {searched}")

    def _places(self) -> Iterator[Path]:
        """The directories to look in; the working directory is only asked for if it is needed."""
        yield from self.directories
        yield working_directory()

    def allows(self, path: str) -> bool:
        """True if a file lies within the root."""
        return self.root is None or os.path.commonpath([self.root, os.path.realpath(path)]) == self.root

    def resolve(self, path: str | os.PathLike[str], /) -> Path:
        """The file or directory that `path` names, or `path` itself if there is none, as in Mitsuba."""
        try:
            return self.find(path)
        except FileError:
            return Path(path)

    @contextlib.contextmanager
    def active(self) -> Iterator[None]:
        """Make `resolve` of this module use this resolver within a ``with`` block."""
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    # ---- the list of directories ---------------------------------------------------------

    def append(self, folder: str | os.PathLike[str], /) -> None:
        """Look in `folder` last."""
        self.directories.append(as_path(folder))

    def prepend(self, folder: str | os.PathLike[str], /) -> None:
        """Look in `folder` first."""
        self.directories.insert(0, as_path(folder))

    def clear(self) -> None:
        """Forget all directories."""
        self.directories.clear()

    def __len__(self) -> int:
        return len(self.directories)

    def __iter__(self) -> Iterator[Path]:
        return iter(self.directories)

    def __getitem__(self, index: int) -> Path:
        return self.directories[index]

    def __setitem__(self, index: int, folder: str | os.PathLike[str]) -> None:
        self.directories[index] = as_path(folder)

    def __delitem__(self, index: int) -> None:
        del self.directories[index]

    def __repr__(self) -> str:
        return f"FileResolver({[str(folder) for folder in self.directories]})"


def working_directory() -> Path:
    """The working directory, also if it has been removed."""
    try:
        return Path.cwd()
    except OSError:
        return Path()


_current: ContextVar[FileResolver | None] = ContextVar("file_resolver", default=None)
# Mitsuba's resolver of the process: scripts replace it or add to it, and then load descriptions.
_of_process = FileResolver(())


def file_resolver() -> FileResolver:
    """The resolver of this process: where all descriptions look for files, after their own directory."""
    return _of_process


def set_file_resolver(resolver: FileResolver, /) -> None:
    """Make `resolver` the resolver of this process.

    Raises:
        FileError: it isn't a resolver.
    """
    global _of_process
    if not isinstance(resolver, FileResolver):
        raise FileError(f"set_file_resolver: expected a djpt.FileResolver, found {type(resolver).__name__}")
    _of_process = resolver


def resolve(name: str) -> Path:
    """The path of a file that is named by the description being loaded; raises `FileError`."""
    return (_current.get() or _of_process).find(name)


def confined() -> bool:
    """True if the description being loaded is a stranger's, which may not leave a folder."""
    resolver = _current.get() or _of_process
    return resolver.root is not None


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
    """The result of `read` or, if the file `name` was read before in the same `form`, the result of then.

    Results may be shared, so they must not be changed; arrays that are kept can't be.
    """
    known = (_kept.get() or {}).get(name)
    if known is None:
        return read()
    if form not in known:
        known[form] = read()
        if hasattr(known[form], "setflags"):
            known[form].setflags(write=False)
    result: T = known[form]
    return result


# ---- scene descriptions that know the file they come from ------------------------------------


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


# ---- files of spectra ------------------------------------------------------------------------

NUMBER = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"
"""A number as text; what Python takes for one is written in other ways as well (nan, 1_000)."""


def read_pairs(filename: str | os.PathLike[str]) -> tuple[list[float], list[float]]:
    """Wavelengths and values in a text file (spd): two numbers a line, apart by spaces or commas; # begins a comment.

    Raises:
        FileError: The file can't be read, or a line has other than two numbers.
    """
    name = as_path(filename)
    try:
        lines = [line.partition("#")[0].strip() for line in read_bytes(name).decode("utf-8").splitlines()]
    except UnicodeError:
        raise FileError(f"can't read '{name}': it isn't a text file") from None
    wavelengths, values = [], []
    for number, line in enumerate(lines, 1):
        if not line:
            continue
        words = re.split(r"[,\s]+", line)
        # What is found isn't quoted: an untrusted scene may name any file.
        if len(words) != 2 or not all(re.fullmatch(NUMBER, word, re.ASCII) for word in words):
            raise FileError(f"{name}:{number}: must be two numbers, a wavelength and a value")
        if max(abs(float(word)) for word in words) > LARGEST:
            raise FileError(f"{name}:{number}: must be finite in single precision")
        wavelengths.append(float(words[0]))
        values.append(float(words[1]))
    return wavelengths, values
