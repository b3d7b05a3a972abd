"""The exception family of djpt, and the part of messages that suggests a near miss.

Every error that a user can cause is a `DjptError`. A message names the node (a scene
path such as ``scene.white``), what was found and what is possible. All are `RuntimeError`,
which is what Mitsuba raises; subclasses also derive from the built-in exception that Python
code would expect to catch.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

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
]


LONGEST = 100
"""The characters of a name that is compared with others, and shown, in messages: the time grows with their square."""

MOST = 200
"""The names that are compared and listed in a message."""


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


def near_miss(found: str, possible: Iterable[str]) -> str:
    """Suggest what is possible: ``; did you mean 'x'?`` or ``; possible: a, b, c``.

    Only a word that may be meant is suggested: a beginning of the other, or few letters away, a quarter of them.
    Returns an empty string if `possible` is empty. Meant to be appended to a message. Where there are very many names,
    some of them are compared and listed.
    """
    names = sorted(set(possible))
    if not names:
        return ""
    short = [name for name in names if len(name) <= LONGEST]
    if len(short) > MOST:
        short = [name for name in short if name[:1] == found[:1]][:MOST]
    near = difflib.get_close_matches(found, short, n=3, cutoff=0.6) if len(found) <= LONGEST else []
    nearest = next((name for name in near if may_mean(found, name)), None)
    listed = ", ".join(name if len(name) <= LONGEST else f"{name[:LONGEST]}.." for name in names[:MOST])
    if len(names) > MOST:
        listed += f" .. ({len(names)})"
    if nearest is not None:
        return f"; did you mean '{nearest}'? (possible: {listed})"
    return f"; possible: {listed}"


def may_mean(found: str, name: str) -> bool:
    """Whether a word looks like a mistake in another one."""
    a, b = found.lower(), name.lower()
    if min(len(a), len(b)) >= 3 and (a.startswith(b) or b.startswith(a)):
        return True
    return mistakes(a, b) <= max(1, round(max(len(a), len(b)) / 4))


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
