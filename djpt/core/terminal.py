r"""Text for terminals: characters that can be seen, and nothing that the terminal would obey.

Names in scenes, names of files and channels, options and the messages of libraries may hold anything, control
characters and overrides of the direction of writing among them. All that the process prints goes through
`VisibleText`, see `show_all`, which writes such characters as Python does, ``\x1b``. What djpt itself tells a
terminal, the bars and colours, is written `beneath` it.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import unicodedata
from collections.abc import Iterator
from typing import Any, TextIO

__all__ = ["VisibleText", "beneath", "show_all", "showing_all", "visible"]


def visible(text: str, kept: str = "") -> str:
    """`text` on one line, with escapes in place of what can't be seen, except for the characters in `kept`.

    Replaced are control characters (C0 and C1), line and paragraph separators, what changes the direction of
    writing or has no width, surrogates (bytes of names that aren't UTF-8), and characters without a meaning.
    """
    if text.isprintable():
        return text
    return "".join(
        c
        if c in kept or c.isprintable() or unicodedata.category(c) == "Zs"
        else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


class VisibleText(io.TextIOBase):
    """A stream that writes to another one what is `visible`, in lines and with tabs."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The other stream's encoding."""
        return self.stream.encoding

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        """The other stream's treatment of characters that it can't encode."""
        return self.stream.errors

    @property
    def buffer(self) -> VisibleBytes:
        """A stream that takes the same text as bytes."""
        return VisibleBytes(self)

    def write(self, text: str) -> int:
        """Write `text`; the number of its characters."""
        self.stream.write(visible(text, kept="\n\t"))
        return len(text)

    def flush(self) -> None:
        """Flush the other stream."""
        self.stream.flush()

    def writable(self) -> bool:
        """True: it can be written to."""
        return True

    def isatty(self) -> bool:
        """True if the other stream is a terminal."""
        return self.stream.isatty()

    def fileno(self) -> int:
        """The number of the other stream's file."""
        return self.stream.fileno()


class VisibleBytes(io.BufferedIOBase):
    """A stream of UTF-8 that writes to a `VisibleText`."""

    def __init__(self, stream: VisibleText) -> None:
        self.stream = stream

    def write(self, data: Any) -> int:
        """Write bytes; their number. Those that aren't UTF-8 are escaped."""
        text = bytes(data)
        self.stream.write(text.decode("utf-8", "surrogateescape"))
        return len(text)

    def flush(self) -> None:
        """Flush the stream of text."""
        self.stream.flush()

    def writable(self) -> bool:
        """True: it can be written to."""
        return True


def beneath(stream: Any) -> Any:
    """The stream that a `VisibleText` writes to, for what the terminal shall obey; any other stream as it is."""
    return stream.stream if isinstance(stream, VisibleText) else stream


def show_all() -> None:
    """From now on, make all that this process prints visible: for good, and also in tracebacks."""
    # Tracebacks would have colours where Python knows how, and they would be escaped.
    os.environ.setdefault("PYTHON_COLORS", "0")
    sys.stdout, sys.stderr = shown(sys.stdout), shown(sys.stderr)


@contextlib.contextmanager
def showing_all() -> Iterator[None]:
    """Make visible what is printed in this block, also where something else has taken the place of stdout."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = shown(sys.stdout), shown(sys.stderr)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def shown(stream: Any) -> Any:
    """A `VisibleText` that writes to `stream`; a closed stream, None, stays."""
    return stream if stream is None or isinstance(stream, VisibleText) else VisibleText(stream)
