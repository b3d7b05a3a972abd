"""The exception family of djpt, and the part of messages that suggests a near miss.

Every error that a user can cause is a `DjptError`. A message names the node (a scene
path such as ``scene.white``), what was found and what is possible. All are `RuntimeError`,
which is what Mitsuba raises; subclasses also derive from the built-in exception that Python
code would expect to catch.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence

__all__ = [
    "AmbiguityError",
    "ArgumentError",
    "BackendError",
    "DjptError",
    "FileError",
    "ParameterError",
    "RenderError",
    "SceneError",
    "near_miss",
    "nearest",
]


LONGEST = 100
"""The characters of a name that is compared with others, and shown, in messages: the time grows with their square."""

MOST = 5000
"""The names that are compared; where there are more, those with the same first letter."""

CLOSEST = 50
"""The names that are compared letter by letter: those that share the most letters."""

LISTED = 10
"""The largest number of names that a message lists."""

ALIKE = 0.6
"""The fraction of common letters, in the same order, above which a name counts as near."""


class DjptError(RuntimeError):
    """The base of all errors that djpt raises on purpose."""


class ArgumentError(DjptError, TypeError, ValueError):
    """An argument of a numerical function has a type or a value that it can't take.

    Mitsuba raises a `TypeError` or a `RuntimeError` here; Python's own functions raise a `ValueError`.
    """


class BackendError(DjptError):
    """No usable Dr.Jit backend, or the variant can no longer change."""


class SceneError(DjptError, ValueError):
    """A scene description is wrong: unknown plugin or key, wrong type, value out of range."""


class ParameterError(DjptError, KeyError):
    """A parameter of `traverse()` has an unknown name, or a value that it can't take."""

    def __str__(self) -> str:  # KeyError would show the repr of the message
        return str(self.args[0]) if self.args else ""


class RenderError(DjptError, ValueError):
    """The arguments of `render()` can't be rendered (spp 0, no sensor, an empty film)."""


class AmbiguityError(DjptError, TypeError):
    """A transform was applied with ``@`` to an array that may hold points, vectors or normals."""


class FileError(DjptError, OSError):
    """A file can't be read or written, or its format isn't known."""


def near_miss(found: str, possible: Iterable[str], label: str = "possible") -> str:
    """Suggest what is possible: ``; did you mean 'x'? (possible: x, b, c)`` or ``; possible: a, b, c``.

    At most ten names are listed: those that are near, the nearest first, then the others in alphabetical order. Only a
    word that may be meant is suggested: one that is the beginning of the other, or differs in a quarter of its letters
    at most. Returns an empty string if `possible` is empty. Meant to be appended to a message; `label` replaces the
    word ``possible``.
    """
    names = sorted(set(possible))
    if not names:
        return ""
    near = nearest_first(found, names)
    shown = [*near, *(name for name in names if name not in near)][:LISTED]
    listed = ", ".join(name if len(name) <= LONGEST else f"{name[:LONGEST]}.." for name in shown)
    if len(names) > len(shown):
        listed += f" and {len(names) - len(shown)} more"
    if near and may_mean(found, near[0]):
        return f"; did you mean '{near[0]}'? ({label}: {listed})"
    return f"; {label}: {listed}"


def nearest(found: str, possible: Iterable[str]) -> str | None:
    """The name that was probably meant, or None, for messages that list no others."""
    near = nearest_first(found, sorted(set(possible)))
    return near[0] if near and may_mean(found, near[0]) else None


def nearest_first(found: str, names: Sequence[str]) -> list[str]:
    """The names that resemble `found`, the most similar first. Of more than `MOST` names only some are compared."""
    if not found or len(found) > LONGEST:
        return []
    short = [name for name in names if len(name) <= LONGEST]
    if len(short) > MOST:
        short = [name for name in short if name[:1] == found[:1]][:MOST]
    word = found.lower()
    from difflib import SequenceMatcher  # takes a twentieth of what `import djpt` takes

    matcher = SequenceMatcher(autojunk=False)
    matcher.set_seq2(word)

    def shared_letters(name: str) -> tuple[bool, float]:
        matcher.set_seq1(name.lower())
        return name.lower().startswith(word), matcher.quick_ratio()

    def similarity(name: str) -> tuple[bool, float]:
        matcher.set_seq1(name.lower())
        return may_mean(found, name), matcher.ratio()

    scored = [(*similarity(name), name) for name in heapq.nlargest(CLOSEST, short, key=shared_letters)]
    alike = [(meant, ratio, name) for meant, ratio, name in scored if ratio >= ALIKE or begins(found, name)]
    return [name for _, _, name in sorted(alike, key=lambda entry: (not entry[0], -entry[1], entry[2]))]


def begins(found: str, name: str) -> bool:
    """True if one of two words is the beginning of the other."""
    a, b = found.lower(), name.lower()
    return min(len(a), len(b)) >= 3 and (a.startswith(b) or b.startswith(a))


def may_mean(found: str, name: str) -> bool:
    """True if a word looks like a mistake in another one."""
    fewest = max(1, round(max(len(found), len(name)) / 4))
    return begins(found, name) or mistakes(found.lower(), name.lower()) <= fewest


def mistakes(a: str, b: str) -> int:
    """The number of letters to insert, delete, replace or swap with a neighbour (F. J. Damerau, CACM 7(3), 1964)."""
    before: list[int] = []
    row = list(range(len(b) + 1))
    for i, letter in enumerate(a, 1):
        earlier, before, row = before, row, [i]
        for j, other in enumerate(b, 1):
            cost = min(before[j] + 1, row[j - 1] + 1, before[j - 1] + (letter != other))
            if i > 1 and j > 1 and letter == b[j - 2] and a[i - 2] == other:
                cost = min(cost, earlier[j - 2] + 1)
            row.append(cost)
    return row[-1]
