"""The lines of an OBJ file, sorted by their keywords.

No loop runs over lines: files have millions. Lines of a kind nearly always follow each other, so that their text
is a few pieces of the file, and NumPy parses it at once.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["KINDS", "Lines", "parse", "sort_lines", "word_starts"]

KINDS = ("v", "vt", "vn", "f")
"""The keywords that matter; lines with others are ignored."""

BLANK, NEWLINE, HASH, BACKSLASH = b" \n#\\"

Characters = NDArray[np.uint8]


@dataclass
class Lines:
    """The lines of one kind, without their keyword."""

    text: bytes
    """All of them, separated by newlines."""
    numbers: NDArray[np.int64]
    """The number of each in the file, from 1."""
    words: NDArray[np.int64]
    """How many words follow each keyword."""

    def rows(self) -> list[bytes]:
        """Each line, to look for the one that is wrong."""
        # A line that was joined from several is one line here.
        return self.text.split(b"\n")[: len(self.numbers)]


def sort_lines(data: bytes) -> dict[str, Lines]:
    """Sort the lines of a file by kind. A backslash at the end of a line joins it with the next one."""
    text = np.frombuffer(bytearray(data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") + b"\n"), np.uint8)
    ends = np.flatnonzero(text == NEWLINE)
    numbers = np.arange(1, len(ends) + 1)
    joined = text[ends - 1] == BACKSLASH
    joined[-1] = False
    if joined.any():
        text[ends[joined]] = text[ends[joined] - 1] = BLANK
        # The joined line has the number of its first part.
        ends, numbers = ends[~joined], numbers[np.append(True, ~joined[:-1])]
    starts = np.concatenate([[0], ends[:-1] + 1])
    if b"#" in data:
        blank_comments(text, ends)
    words = word_starts(text)
    first = np.searchsorted(words, starts)
    counts = np.diff(np.append(first, len(words)))
    kind = np.zeros(len(starts), np.uint8)
    some = np.flatnonzero(counts)
    kind[some] = keywords(text, words[first[some]])
    pieces: list[list[Characters]] = [[] for _ in range(len(KINDS) + 1)]
    for begin, end in pairwise(np.flatnonzero(np.diff(kind, prepend=255, append=255)).tolist()):
        pieces[kind[begin]].append(text[starts[begin] : ends[end - 1] + 1])
    result = {}
    for number, name in enumerate(KINDS, 1):
        found, own = pieces[number], kind == number
        content = np.concatenate(found).tobytes() if found else b""
        result[name] = Lines(content, numbers[own], counts[own] - 1)
    return result


def blank_comments(text: Characters, ends: NDArray[np.int64]) -> None:
    """Overwrite what follows a ``#``, up to the end of its line, by blanks."""
    marks = np.flatnonzero(text == HASH)
    line, first = np.unique(np.searchsorted(ends, marks), return_index=True)
    change = np.zeros(len(text) + 1, np.int8)
    change[marks[first]], change[ends[line]] = 1, -1
    text[np.cumsum(change[:-1], dtype=np.int8) == 1] = BLANK


def word_starts(text: Characters) -> NDArray[np.int64]:
    """Where a word begins: after a blank, a newline or the like, or at the start."""
    filled = text > BLANK
    starts = filled.copy()
    starts[1:] &= ~filled[:-1]
    return np.flatnonzero(starts)


def keywords(text: Characters, place: NDArray[np.int64]) -> NDArray[np.uint8]:
    """The kinds, from 1, of lines whose first words begin at these places, or 0. Keywords are overwritten by blanks."""
    kind = np.zeros(len(place), np.uint8)
    last = len(text) - 1
    a, b, c = (text[np.minimum(place + k, last)] for k in range(3))
    for number, name in enumerate(KINDS, 1):
        if len(name) == 1:
            found = (a == ord(name)) & (b <= BLANK)
        else:
            found = (a == ord(name[0])) & (b == ord(name[1])) & (c <= BLANK)
            text[place[found] + 1] = BLANK
        text[place[found]] = BLANK
        kind[found] = number
    return kind


def parse(text: bytes, dtype: type[np.generic]) -> NDArray[Any] | None:
    """Parse numbers separated by blanks or newlines; None if there is anything else."""
    with warnings.catch_warnings():
        # Text that isn't numbers is a deprecation warning in NumPy, an error in later versions.
        warnings.simplefilter("error")
        try:
            return np.fromstring(text.decode("latin-1"), dtype, sep=" ")
        except (DeprecationWarning, ValueError, OverflowError):
            return None
