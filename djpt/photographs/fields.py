"""Numbers in the files of strangers, checked where they are read."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.files import shortened
from djpt.errors import SceneError

__all__ = ["LARGEST", "integer", "listed", "number", "numbers", "parsed_json", "shown"]

LARGEST = 1e30
"""The largest number that means anything: squares of larger ones are infinite in kernels."""


def number(value: Any, what: str) -> float:
    """A finite number, given as such or as a word of a text; raises `SceneError`, which calls it `what`."""
    try:
        found = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not abs(found) <= LARGEST:  # NaN, too
        raise SceneError(f"{what} must be a finite number, found {shown(value)}")
    return found


def integer(value: Any, what: str, low: int = 0, high: int = 2**63) -> int:
    """A whole number in a range; raises `SceneError`."""
    found = number(value, what)
    if not found.is_integer() or not low <= found <= high:
        raise SceneError(f"{what} must be a whole number from {low} to {high}, found {shown(value)}")
    return int(found)


def numbers(values: Any, what: str, *shapes: tuple[int, ...]) -> NDArray[np.float64]:
    """Finite numbers in one of some shapes, or in any if none is given; raises `SceneError`."""
    try:
        found = np.asarray(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise SceneError(f"{what} must be numbers, found {shown(values)}") from None
    if shapes and found.shape not in shapes:
        possible = " or ".join(" x ".join(map(str, shape)) for shape in shapes)
        raise SceneError(f"{what} must have {possible} numbers, found {' x '.join(map(str, found.shape)) or 'one'}")
    if not (np.abs(found) <= LARGEST).all():
        raise SceneError(f"{what} must be finite numbers, found {shown(values)}")
    return found


def shown(value: Any) -> str:
    """A value for messages."""
    text = shortened(value if isinstance(value, str) else repr(value))
    return f"'{text}'" if isinstance(value, str) else text


def parsed_json(data: bytes, name: str) -> dict[str, Any]:
    """The object of a JSON file; raises `SceneError`."""
    import json

    try:
        found = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{name}: isn't JSON: {error}") from None
    if not isinstance(found, dict):
        raise SceneError(f"{name}: must hold an object, found {type(found).__name__}")
    return found


def listed(names: Iterable[str]) -> str:
    """Names for a message, the first few."""
    found = [shortened(name) for name in names]
    return ", ".join(found[:10]) + (" .." if len(found) > 10 else "")
