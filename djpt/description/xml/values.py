"""The value tags of a scene file: numbers, vectors, colours, spectra."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

from djpt.core.limits import LARGEST
from djpt.description.files import NUMBER, read_pairs
from djpt.description.xml.source import Element
from djpt.errors import FileError, near_miss

__all__ = ["VALUES", "check_attributes", "number", "numbers", "spectrum_file", "vector"]

_FLOAT = re.compile(NUMBER, re.ASCII)
_PLAIN = re.compile(r"[-+.eE:,\s\d]*", re.ASCII)
"""The characters of pairs of numbers; what Python takes for numbers is written in others as well (nan, 1_000)."""
_INTEGER = re.compile(r"[+-]?\d{1,19}", re.ASCII)
_SEPARATORS = re.compile(r"[,\s]+")


def check_attributes(element: Element, required: str = "", optional: str = "") -> None:
    """Raise `SceneError` for an attribute that is missing or unknown. Names are separated by spaces."""
    possible = [*required.split(), *optional.split()]
    for name in element.attributes:
        if name not in possible:
            raise element.error(f"unknown attribute '{name}'{near_miss(name, possible)}")
    for name in required.split():
        if name not in element.attributes:
            found = ", ".join(element.attributes) or "none"
            raise element.error(f"the attribute '{name}' is missing (found: {found})")


def number(element: Element, text: str) -> float:
    """Parse a finite number."""
    if not _FLOAT.fullmatch(text.strip()):
        raise element.error(f"must be a number, found '{text}'")
    value = float(text)
    if abs(value) > LARGEST:
        raise element.error(f"must be finite in single precision, found '{text}'")
    return value


def numbers(element: Element, text: str) -> list[float]:
    """Parse numbers that are separated by spaces or commas."""
    return [number(element, part) for part in _SEPARATORS.split(text) if part]


def vector(element: Element, default: float | None, extra: str = "") -> list[float]:
    """Parse the attributes ``x``, ``y``, ``z``, or ``value`` with three numbers or one for all.

    `default` stands for a missing component (None: all must be there); `extra` names further
    attributes, which are required.
    """
    if "value" in element.attributes:
        check_attributes(element, f"value {extra}")
        found = numbers(element, element.attributes["value"])
        if len(found) not in (1, 3):
            raise element.error(f"'value' must be one or three numbers, found {len(found)}")
        return found * 3 if len(found) == 1 else found
    if default is None:
        check_attributes(element, f"{extra} x y z")
    else:
        check_attributes(element, extra, "x y z value")
    texts = [element.attributes.get(axis) for axis in "xyz"]
    return [default or 0.0 if text is None else number(element, text) for text in texts]


# ---- one function per tag: its entry in the dict -------------------------------------------


def _integer(element: Element) -> int:
    text = element.attributes["value"]
    if not _INTEGER.fullmatch(text.strip()):
        raise element.error(f"must be a whole number, found '{text}'")
    return int(text)


def _boolean(element: Element) -> bool:
    text = element.attributes["value"].lower()
    if text not in ("true", "false"):
        raise element.error(f"must be true or false, found '{element.attributes['value']}'")
    return text == "true"


def _rgb(element: Element) -> dict[str, Any]:
    found = numbers(element, element.attributes["value"])
    if len(found) not in (1, 3):
        raise element.error(f"must be one or three numbers, found {len(found)}: '{element.attributes['value']}'")
    return {"type": "rgb", "value": found * 3 if len(found) == 1 else found}


def _spectrum(element: Element) -> dict[str, Any]:
    text = element.attributes["value"]
    parts = [part for part in _SEPARATORS.split(text) if part]
    if len(parts) == 1 and ":" not in text:
        return {"type": "spectrum", "value": number(element, parts[0])}
    pairs = _plain_pairs(text, parts) or [_pair(element, part) for part in parts]
    _check_pairs(element, pairs)
    return {"type": "spectrum", "value": pairs}


def _plain_pairs(text: str, parts: list[str]) -> list[tuple[float, float]] | None:
    """Parse pairs of numbers at once; None if there is anything to say about them."""
    if not _PLAIN.fullmatch(text):
        return None
    try:
        pairs = [(float(wavelength), float(value)) for wavelength, value in (part.split(":") for part in parts)]
    except ValueError:
        return None
    return pairs if all(max(abs(a), abs(b)) <= LARGEST for a, b in pairs) else None


def _pair(element: Element, text: str) -> tuple[float, float]:
    """Parse a wavelength and a value."""
    wavelength, colon, value = text.partition(":")
    if not colon:
        raise element.error(f"must be one number or pairs such as '400:0.1, 700:0.2', found '{text}'")
    return number(element, wavelength), number(element, value)


def spectrum_file(element: Element, path: Path) -> dict[str, Any]:
    """Read the spectrum in a text file: a wavelength in nm and a value per line, ``#`` for comments."""
    try:
        pairs = list(zip(*read_pairs(path), strict=True))
    except FileError as error:
        raise element.error(str(error)) from None
    _check_pairs(element, pairs)
    return {"type": "spectrum", "value": pairs}


def _check_pairs(element: Element, pairs: list[tuple[float, float]]) -> None:
    if len(pairs) < 2:
        raise element.error(f"a spectrum needs at least two wavelengths, found {len(pairs)}")
    for (before, _), (after, _) in pairwise(pairs):
        if after <= before:
            raise element.error(f"wavelengths must increase, found {after:g} after {before:g}")


def _vector(element: Element) -> list[float]:
    return vector(element, None, "name")


def _with_value(read: Callable[[Element], Any]) -> Callable[[Element], Any]:
    """Wrap the function of a tag that has a name and a value and nothing else."""

    def checked(element: Element) -> Any:
        check_attributes(element, "name value")
        return read(element)

    return checked


VALUES: dict[str, Callable[[Element], Any]] = {
    "boolean": _with_value(_boolean),
    "integer": _with_value(_integer),
    "float": _with_value(lambda element: number(element, element.attributes["value"])),
    "string": _with_value(lambda element: element.attributes["value"]),
    "rgb": _with_value(_rgb),
    "spectrum": _with_value(_spectrum),
    "point": _vector,
    "vector": _vector,
}
"""The function of each tag, which gives the entry in the dict; raises `SceneError` with the element's place."""
