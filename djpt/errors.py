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

    Returns an empty string if `possible` is empty. Meant to be appended to a message.
    """
    names = sorted(set(possible))
    if not names:
        return ""
    close = difflib.get_close_matches(found, names, n=1, cutoff=0.6)
    if close:
        return f"; did you mean '{close[0]}'? (possible: {', '.join(names)})"
    return f"; possible: {', '.join(names)}"
