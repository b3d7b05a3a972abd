"""Files: only regular ones are read or replaced, and what is written appears whole or not at all.

A name in a scene may be that of a device without an end, or of a pipe that nobody writes to: reading one would
fill the memory or wait for ever.
"""

from __future__ import annotations

import contextlib
import os
import stat
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO

from djpt.errors import DjptError, FileError

if sys.platform != "win32":
    import fcntl

__all__ = [
    "as_path",
    "check_target",
    "errors_of_writing",
    "open_regular",
    "read_bytes",
    "reason",
    "remove_unfinished",
    "replacing",
    "require_different",
    "require_regular",
    "shortened",
    "writing",
]

KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}
"""Names of files that aren't regular ones, by the type in `st_mode`."""

LONGEST = 200
"""The characters of a name that messages show."""


def as_path(name: str | os.PathLike[str]) -> Path:
    """The path that `name` stands for; raises `FileError` unless it is a text or a path."""
    if isinstance(name, Path):
        return name
    try:
        return Path(name)
    except TypeError:
        raise FileError(f"a file's name must be a text or a path, found {type(name).__name__}") from None


# ---- reading -------------------------------------------------------------------------------


def require_regular(path: str | os.PathLike[str]) -> None:
    """Raise `FileError` unless `path` is a regular file, or a link to one, that may be read."""
    open_regular(path).close()


def open_regular(path: str | os.PathLike[str]) -> IO[bytes]:
    """Open a file for reading; raises `FileError` unless it is a regular one, or a link to one."""
    path = as_path(path)
    try:
        # Without waiting: opening a pipe to read would wait until somebody writes to it.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise FileError(f"can't read '{shortened(path)}': there is no such file") from None
    except (OSError, ValueError) as error:
        problem = "it is a socket, not a regular file" if is_socket(path) else reason(error)
        raise FileError(f"can't read '{shortened(path)}': {problem}") from None
    kind = kind_of(os.fstat(descriptor))
    if kind is None:
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    raise FileError(f"can't read '{shortened(path)}': it is {kind}, not a regular file")


def is_socket(path: str | os.PathLike[str]) -> bool:
    """True if a file that can't be opened is a socket: those can't."""
    try:
        return stat.S_ISSOCK(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


def kind_of(status: os.stat_result) -> str | None:
    """The name of a file's type, such as a socket; None for a regular file."""
    kind = stat.S_IFMT(status.st_mode)
    return None if kind == stat.S_IFREG else KINDS.get(kind, "something else")


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Read a file; raises `FileError` unless it is a regular one that can be read and fits into memory."""
    file = open_regular(path)
    try:
        with file:
            return file.read()
    except (OSError, MemoryError) as error:
        raise FileError(f"can't read '{shortened(path)}': {reason(error)}") from None


# ---- writing -------------------------------------------------------------------------------


def check_target(target: Path) -> Path:
    """Find out where a file will be written: `target` without links.

    Raises:
        FileError: it can't be written: a folder, a device, a pipe or a socket is in its place, or the folder
            doesn't exist or may not be written to.
    """
    try:
        real = Path(os.path.realpath(target))
        kind = kind_of(real.stat()) if real.exists() else None
        has_folder = real.parent.is_dir()
    except (OSError, ValueError) as error:
        raise FileError(f"can't write '{shortened(target)}': {reason(error)}") from None
    if kind is not None:
        raise FileError(f"can't write '{target}': it is {kind}")
    if not has_folder:
        raise FileError(f"can't write '{target}': there is no folder '{real.parent}'")
    if not os.access(real.parent, os.W_OK | os.X_OK):
        raise FileError(f"can't write '{target}': no permission to write in '{real.parent}'")
    return real


def require_different(outputs: Mapping[str, Path | None], inputs: Mapping[str, Path | None] | None = None) -> None:
    """Raise `FileError` if an output is an input or another output; links are followed.

    Files are given by what messages call them; None stands for an option that isn't used.
    """
    known = {name: path for name, path in (inputs or {}).items() if path is not None}
    for name, path in outputs.items():
        if path is None:
            continue
        for other, before in known.items():
            if is_same(path, before):
                raise FileError(f"{other} and {name} are the same file, '{shortened(path)}'")
        known[name] = path


def is_same(a: Path, b: Path) -> bool:
    """True if two paths, which needn't exist, are of the same file."""
    try:
        return os.path.realpath(a) == os.path.realpath(b) or os.path.samefile(a, b)
    except (OSError, ValueError):
        return False


@contextlib.contextmanager
def writing(target: Path) -> Iterator[Path]:
    """A path to write to, as `replacing` gives it; raises `FileError` for whatever goes wrong meanwhile."""
    with errors_of_writing(target), replacing(target) as temporary:
        yield temporary


@contextlib.contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """A path to write to, with the extension of `target`, whose place the file takes when all went well.

    If not, an old file stays as it was. What a writing that was killed has left in the folder is removed.
    Raises `FileError` if `target` can't be written.
    """
    # A link is followed, so that it stays a link. The name begins with a dot and keeps the extension.
    real = check_target(target)
    remove_leftovers(real)
    temporary = real.with_name(f"{prefix(real)}{os.urandom(4).hex()}{real.suffix}")
    unfinished.add(temporary)
    try:
        with errors_of_writing(target):
            lock = locked(temporary)
        with lock:
            yield temporary
            with errors_of_writing(target):
                with temporary.open("rb+") as file:
                    os.fsync(file.fileno())  # otherwise a crash may leave the new name with no content
                if real.exists():
                    temporary.chmod(real.stat().st_mode & 0o777)
                temporary.replace(real)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        unfinished.discard(temporary)


@contextlib.contextmanager
def errors_of_writing(target: Path) -> Iterator[None]:
    """Turn whatever goes wrong while a file is written into a `FileError`."""
    try:
        yield
    except DjptError:
        raise
    except (OSError, RuntimeError, ValueError, MemoryError) as error:
        raise FileError(f"can't write '{shortened(target)}': {reason(error)}") from error


unfinished: set[Path] = set()
"""The temporary files of this process: what a signal that ends it has to remove."""


def remove_unfinished() -> None:
    """Remove the temporary files of this process, which is about to end in the middle of writing them."""
    for temporary in list(unfinished):
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def prefix(real: Path) -> str:
    """The prefix of the names of a target's temporary files."""
    return f".{real.stem[:100]}."


def locked(temporary: Path) -> IO[bytes]:
    """Make an empty file, which is locked as long as this process has it open."""
    file = temporary.open("xb")
    if sys.platform != "win32":
        fcntl.flock(file, fcntl.LOCK_SH)
    return file


def remove_leftovers(real: Path) -> None:
    """Remove the temporary files of a target that no process is writing any more."""
    if sys.platform == "win32":
        return
    digits = frozenset("0123456789abcdef")
    for path in real.parent.iterdir():
        middle = path.name.removeprefix(prefix(real)).removesuffix(real.suffix)
        if path.name != f"{prefix(real)}{middle}{real.suffix}" or len(middle) != 8 or not digits.issuperset(middle):
            continue
        with contextlib.suppress(OSError), path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()


# ---- messages ------------------------------------------------------------------------------


def reason(error: BaseException) -> str:
    """The reason of an error in one line, without the path, which the message has already."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    if isinstance(error, MemoryError):
        return "out of memory"
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


def shortened(path: object) -> str:
    """A name for messages."""
    text = str(path)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}.."
