"""The files that a scene was read from, and whether one of them has changed."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

__all__ = ["Watch"]


class Watch:
    """Notices new versions of files by their size and time of change."""

    def __init__(self, files: Iterable[Path]) -> None:
        self.files = tuple(files)
        """The files that are watched."""
        self._seen = self._state()

    def has_changed(self) -> bool:
        """Whether a file has changed since the last call. A file that is missing for a moment hasn't."""
        state = self._state()
        changed = any(new is not None and new != old for new, old in zip(state, self._seen, strict=True))
        self._seen = tuple(old if new is None else new for new, old in zip(state, self._seen, strict=True))
        return changed

    def _state(self) -> tuple[tuple[int, int] | None, ...]:
        return tuple(stamp(path) for path in self.files)


def stamp(path: Path) -> tuple[int, int] | None:
    """The time of change in nanoseconds and the size of a file; None if there is none."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size
