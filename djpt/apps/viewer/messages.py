"""Messages from pages: untrusted JSON objects, and the numbers in them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from djpt.core.limits import LARGEST
from djpt.errors import RenderError

__all__ = ["in_one_line", "is_number", "number", "parsed", "whole_number"]

LONGEST = 500
"""The number of characters of an error that pages are sent."""


def parsed(text: str | bytes) -> dict[str, Any]:
    """The message of a page; one that isn't a JSON object becomes an unknown request."""
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        message = None
    return message if isinstance(message, dict) else {"do": "something that isn't a message"}


def is_number(value: object) -> bool:
    """True if a value is a finite number that float32 holds: JSON also has integers of any length, NaN and Infinity."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST


def number(message: Mapping[str, Any], name: str) -> float:
    """The number of a message by its name; raises `RenderError` if it isn't one."""
    value = message.get(name)
    if not is_number(value):
        raise RenderError(f"'{name}' must be a finite number, found {type(value).__name__}")
    return float(message[name])


def whole_number(message: Mapping[str, Any], name: str) -> int:
    """The number of a message by its name, truncated to an integer."""
    return int(number(message, name))


def in_one_line(error: BaseException) -> str:
    """An error as pages show it, in one line."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}.."
