"""The tag ``<transform>``: operations in the order of the file, each applied after those above it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from djpt.core.transforms import ScalarTransform4f
from djpt.core.transforms.base import rotation
from djpt.description.xml.source import Element, check_attributes, number, numbers, vector
from djpt.errors import SceneError, near_miss

__all__ = ["transform"]


def transform(element: Element, substitute: Callable[[Element], None]) -> ScalarTransform4f:
    """The product of the operations nested in a ``<transform>``, the last one leftmost.

    `substitute` replaces the parameters in an element's attributes. Raises `SceneError`.
    """
    check_attributes(element, "name")
    result = ScalarTransform4f()
    for child in element.children:
        if child.tag not in OPERATIONS:
            raise child.error(f"can't stand in a <transform>{near_miss(child.tag, OPERATIONS)}")
        for inner in child.children:
            raise inner.error(f"can't stand in a <{child.tag}>")
        substitute(child)
        try:
            result = OPERATIONS[child.tag](child) @ result
        except SceneError as error:
            if str(error).startswith(child.place):
                raise
            raise child.error(str(error)) from None
    return result


def _rotate(element: Element) -> ScalarTransform4f:
    """A rotation; what Mitsuba makes of an axis without unit length, for files that contain one."""
    axis, angle = vector(element, 0.0, "angle"), number(element, element.attributes["angle"])
    return ScalarTransform4f(rotation(axis, angle, f"{element.place}: <rotate>", 2))


def _look_at(element: Element) -> ScalarTransform4f:
    check_attributes(element, "origin target", "up")
    vectors = {}
    for name in ("origin", "target", "up"):
        found = numbers(element, element.attributes.get(name, "0 0 0"))
        if len(found) != 3:
            raise element.error(f"'{name}' must be three numbers, found {len(found)}: '{element.attributes[name]}'")
        vectors[name] = found
    if not any(vectors["up"]):
        vectors["up"] = _perpendicular(vectors["origin"], vectors["target"])
    return ScalarTransform4f.look_at(**vectors)


def _perpendicular(origin: list[float], target: list[float]) -> list[float]:
    """A direction perpendicular to the direction of view, for a ``<lookat>`` without `up`.

    As in Mitsuba, the first tangent of Duff et al., "Building an Orthonormal Basis, Revisited" (JCGT 2017).
    """
    x, y, z = np.subtract(target, origin)
    length = float(np.sqrt(x * x + y * y + z * z))
    if length == 0:
        return [0.0, 1.0, 0.0]  # look_at raises the error
    x, y, z = x / length, y / length, z / length
    sign = float(np.copysign(1.0, z))
    a = -1 / (sign + z)
    return [1 + sign * x * x * a, sign * x * y * a, -sign * x]


def _matrix(element: Element) -> ScalarTransform4f:
    check_attributes(element, "value")
    found = numbers(element, element.attributes["value"])
    if len(found) not in (9, 16):
        raise element.error(f"must be 9 or 16 numbers, found {len(found)}")
    matrix = np.eye(4)
    size = 4 if len(found) == 16 else 3
    matrix[:size, :size] = np.reshape(found, (size, size))
    return ScalarTransform4f(matrix)


OPERATIONS: dict[str, Callable[[Element], ScalarTransform4f]] = {
    "translate": lambda element: ScalarTransform4f.translate(vector(element, 0.0)),
    "scale": lambda element: ScalarTransform4f.scale(vector(element, 1.0)),
    "rotate": _rotate,
    "lookat": _look_at,
    "matrix": _matrix,
}
"""The operations of a ``<transform>``, by tag."""
