"""Messages from pages, which are untrusted, and the parameters of a scene as sliders and colour pickers of the page."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.limits import LARGEST, MAX_NAME
from djpt.description.parameters import SceneParameters
from djpt.errors import ParameterError, RenderError

__all__ = ["changed", "controls", "in_one_line", "number", "parsed", "whole_number"]

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


# ---- parameters as sliders and colour pickers ------------------------------------------------


MOST = 200
"""The number of controls that a page can have; scenes of thousands of materials show the first ones."""

PLACES = frozenset({"position", "direction", "center", "normal"})
"""The names of parameters of three numbers that aren't colours."""

SHARES = ("reflectance", "transmittance", "albedo", "alpha", "roughness", "weight", "color")
"""Parts of the names of parameters that lie between 0 and 1."""

CAMERA = frozenset({"x_fov", "aperture_radius", "focus_distance"})
"""The names of camera parameters, which have no derivatives but are worth a slider."""


def controls(params: SceneParameters) -> list[dict[str, Any]]:
    """The data with which the page shows parameters (single numbers and colours), `MOST` at most.

    Each has `key`, `kind` (``colour``, ``point`` or ``number``), `value` (a list of numbers), and for numbers the
    range `low` to `high` of a slider.
    """
    found: list[dict[str, Any]] = []
    for key, values in single(params):
        name = key.rpartition(".")[2]
        if len(values) == 3:
            found.append({"key": key, "kind": "point" if name in PLACES else "colour", "value": values})
        else:
            low, high = bounds(key, values[0])
            found.append({"key": key, "kind": "number", "value": values, "low": low, "high": high})
        if len(found) == MOST:
            break
    return found


def single(params: SceneParameters) -> Iterator[tuple[str, list[float]]]:
    """The keys and values of parameters that are one number or three."""
    for key in params:
        if not (params.flags(key).differentiable or key.rpartition(".")[2] in CAMERA | PLACES):
            continue
        value = params[key]
        if isinstance(value, float):
            yield key, [value]
        elif dr.is_array_v(value) and not dr.is_tensor_v(value) and not dr.is_matrix_v(value) and dr.is_float_v(value):
            numbers = np.array(value, np.float64).ravel()
            if numbers.size == 1 or (numbers.size == 3 and dr.size_v(value) == 3):
                yield key, [float(number) for number in numbers]


def bounds(key: str, value: float) -> tuple[float, float]:
    """The range of a slider: 0 to 1 for fractions, else around the value."""
    if any(part in key for part in SHARES) and 0 <= value <= 1:
        return 0.0, 1.0
    if key.endswith("x_fov"):
        return 1.0, 170.0
    if value == 0:
        return -1.0, 1.0
    span = 4 * abs(value)
    return (0.0, span) if value > 0 else (-span, span)


def changed(params: SceneParameters, key: Any, numbers: Any) -> None:
    """Set a parameter to another value.

    Raises:
        ParameterError: There is no such parameter, or the value doesn't fit.
    """
    if not isinstance(key, str):
        raise ParameterError(f"expected the name of a parameter, found {type(key).__name__}")
    if not isinstance(numbers, list) or len(numbers) not in (1, 3) or not all(map(is_number, numbers)):
        raise ParameterError(f"{key[:MAX_NAME]}: expected one or three finite numbers")
    params[key] = numbers[0] if len(numbers) == 1 else numbers
    params.update()
