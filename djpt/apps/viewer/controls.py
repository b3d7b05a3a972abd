"""The parameters of a scene as sliders and colour pickers of the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import numpy as np

from djpt.apps.viewer.messages import is_number
from djpt.core.limits import MAX_NAME
from djpt.description.parameters import SceneParameters
from djpt.errors import ParameterError

__all__ = ["MOST", "changed", "controls"]

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
