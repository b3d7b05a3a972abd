"""The parameters ``$name`` of a scene file: their values, and whether they are used."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any

from djpt.errors import SceneError, near_miss

__all__ = ["LONGEST", "Parameters"]

LONGEST = 1_000_000
"""Most characters of an attribute after substitution: parameters made of parameters grow exponentially."""

_NAME = re.compile(r"\w*")


class Parameters:
    r"""The parameters of one call of `load_file`, shared by all files that it reads.

    A name is replaced wherever it follows a ``$``, also in the middle of a text; among several that
    fit, the longest counts. ``\$`` is a plain dollar sign.

    Args:
        given: the caller's values: strings, numbers, booleans, or sequences of numbers.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        self._values = {name: _text(name, value) for name, value in given.items()}
        self._given = frozenset(self._values)
        self._known: set[str] = set()
        """Names that a file declares or uses."""
        self._used: set[str] = set()
        self._sort()

    def _sort(self) -> None:
        self._by_length = sorted(self._values, key=len, reverse=True)

    def declare(self, name: str, value: str) -> None:
        """Declare a ``<default>``, which counts unless there is a value already."""
        self._known.add(name)
        if name not in self._values:
            self._values[name] = value
            self._sort()

    def substitute(self, text: str) -> str:
        """`text` with all parameters replaced.

        Raises:
            SceneError: an unknown parameter, or the result is too long.
        """
        if "$" not in text:
            return text
        parts, start = [], 0
        while (at := text.find("$", start)) >= 0:
            if at > 0 and text[at - 1] == "\\":
                parts.append(text[start : at - 1] + "$")
                start = at + 1
                continue
            name = next((n for n in self._by_length if text.startswith(n, at + 1)), None)
            if name is None:
                raise self._unknown(text[at + 1 :])
            self._known.add(name)
            self._used.add(name)
            parts += [text[start:at], self._values[name]]
            start = at + 1 + len(name)
            if sum(map(len, parts)) > LONGEST:
                raise SceneError(f"longer than {LONGEST} characters after substitution")
        return "".join([*parts, text[start:]])

    def _unknown(self, rest: str) -> SceneError:
        found = _NAME.match(rest)
        name = found[0] if found else ""
        if not name:
            hint = "; write $name" if rest.startswith("{") else r"; write \$ for a dollar sign"
            return SceneError(f"'$' without the name of a parameter{hint}")
        hint = near_miss(name, self._values)
        return SceneError(
            f"unknown parameter '${name}'{hint or f'; give {name}=... or write <default> in front of its first use'}"
        )

    def check_all_used(self, where: str) -> None:
        """Raise `SceneError` for a value that was given and that no file uses; `where` names the file."""
        for name in sorted(self._given - self._used):
            hint = near_miss(name, self._known - self._given) or "; the file has no parameters"
            raise SceneError(f"{where}: the parameter '{name}' isn't used{hint}")


def _text(name: str, value: Any) -> str:
    """Convert a parameter's value to the text that a file would have."""
    if not name:
        raise SceneError("a parameter needs a name")
    if isinstance(value, str):
        return value
    # Here: only Python callers have other values, and NumPy takes long to import.
    import numpy as np

    from djpt.core.numeric import as_array, describe

    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    try:
        numbers = as_array(value)
    except SceneError:
        raise SceneError(
            f"the parameter '{name}' must be a string, a number, a boolean or several numbers, found {describe(value)}"
        ) from None
    return " ".join(repr(float(x)) for x in numbers.ravel())
