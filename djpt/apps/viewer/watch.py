"""Detection of changes in the files that a scene was read from."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

__all__ = ["Watch"]


class Watch:
    """Detects new versions of files by their size and modification time."""

    def __init__(self, files: Iterable[Path]) -> None:
        self.files = tuple(files)
        """The files that are watched."""
        self._seen = self._state()

    def has_changed(self) -> bool:
        """True if a file has changed since the last call. A file that is missing momentarily hasn't."""
        state = self._state()
        changed = any(new is not None and new != old for new, old in zip(state, self._seen, strict=True))
        self._seen = tuple(old if new is None else new for new, old in zip(state, self._seen, strict=True))
        return changed

    def _state(self) -> tuple[tuple[int, int] | None, ...]:
        return tuple(stamp(path) for path in self.files)


def stamp(path: Path) -> tuple[int, int] | None:
    """The modification time in nanoseconds and the size of a file; None if it doesn't exist."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size
