"""Damage to files: cut, flipped, moved and overwritten bytes, numbers that claim too much."""

from __future__ import annotations

import re
from collections.abc import Callable

from hypothesis import strategies as st

__all__ = ["damaged"]

COUNTS = tuple(
    number.to_bytes(size, "little")
    for size in (1, 2, 4, 8)
    for number in (0, 1, 2 ** (8 * size - 1) - 1, 2 ** (8 * size - 1), 2 ** (8 * size) - 1)
)
"""Lengths as they stand in binary files."""

WORDS = (
    b"9" * 20, b"9" * 5000, b"-1", b"0", b"nan", b"inf", b"1e400", b"4294967296", b"-2147483649", b"", b"x", b"0.5",
    "\u0663\U0001f4a5".encode(), b"\0", b"..", b"/dev/zero", b"$width", b"&amp;", b"<", b"\xff\xfe",
)  # fmt: skip
"""Words to put in the place of words of texts."""

MOST_BYTES = 1 << 22
"""What repeated lines may take: a few accidents in a row would make gigabytes of a picture, which is one line."""

Damage = Callable[[bytes, int, int], bytes]


def cut(data: bytes, at: int, n: int) -> bytes:
    """Lose the end."""
    return data[:at]


def flip(data: bytes, at: int, n: int) -> bytes:
    """Change one bit."""
    return data[:at] + bytes([data[at] ^ (1 << n % 8)]) + data[at + 1 :] if data else data


def lose(data: bytes, at: int, n: int) -> bytes:
    """Lose some bytes."""
    return data[:at] + data[at + n :]


def repeat(data: bytes, at: int, n: int) -> bytes:
    """Have some bytes twice."""
    return data[: at + n] + data[at:]


def count(data: bytes, at: int, n: int) -> bytes:
    """Overwrite some bytes with a number that may be a length."""
    number = COUNTS[n % len(COUNTS)]
    return data[:at] + number + data[at + len(number) :]


def word(data: bytes, at: int, n: int) -> bytes:
    """Replace a word of a text."""
    words = list(re.finditer(rb"[\w.+-]+", data))
    if not words:
        return data
    found = words[at % len(words)]
    return data[: found.start()] + WORDS[n % len(WORDS)] + data[found.end() :]


def line(data: bytes, at: int, n: int) -> bytes:
    """Lose a line, or have one many times."""
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    i = at % len(lines)
    copies = min(n % 3 * 100, MOST_BYTES // len(lines[i]))
    return b"".join(lines[:i] + lines[i : i + 1] * copies + lines[i + 1 :])


def dusty(data: bytes, at: int, n: int) -> bytes:
    """Zero or fill all bytes from one on."""
    return data[:at] + bytes([255 * (n % 2)]) * (len(data) - at)


DAMAGES: tuple[Damage, ...] = (cut, flip, lose, repeat, count, word, line, dusty)


@st.composite
def damaged(draw: st.DrawFn, data: bytes) -> bytes:
    """The contents of a file after one to four accidents."""
    for _ in range(draw(st.integers(1, 4))):
        accident = draw(st.sampled_from(DAMAGES))
        # Most of what is interesting stands in headers.
        last = max(0, len(data) - 1)
        at = draw(st.one_of(st.integers(0, min(last, 64)), st.integers(0, last)))
        data = accident(data, at, draw(st.integers(0, 255)))
    return data
