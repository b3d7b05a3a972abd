"""Sensors that no transform places: along a direction, on a shape."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import coordinate_system
from djpt.core.transforms import ScalarTransform4f
from djpt.description.properties import Properties
from djpt.errors import SceneError
from djpt.jit.types import Vector3f
from djpt.shapes.axes import AxisPool
from djpt.shapes.meshes.mesh_set import MeshSet

if TYPE_CHECKING:
    from djpt.shapes import Shape

__all__ = ["look_along", "placed_apart", "require_area"]


def look_along(props: Properties, origin: NDArray[np.float64], upwards: int = 1) -> ScalarTransform4f:
    """The transform of a sensor at `origin` that looks along the entry `direction`.

    `upwards` says which of the two tangents of `coordinate_system` points up.
    """
    direction = props.vector("direction")
    length = float(np.linalg.norm(direction))
    if length == 0:
        raise props.error("direction", "must not be the zero vector")
    direction = direction / length
    up = coordinate_system(Vector3f(*direction.tolist()))[upwards]
    return ScalarTransform4f.look_at(origin=origin, target=origin + direction, up=np.array(up).ravel())


def require_area(shape: Shape, sensor: str) -> None:
    """Raise `SceneError` if no points can be drawn on a shape."""
    if not shape.has_area:
        name = type(shape).__name__.lower()
        raise SceneError(f"{shape.id()}: '{sensor}' samples points by area, but the area of '{name}' is unknown")


def placed_apart(shape: Shape) -> Any:
    """A copy of a shape as it is now, ready to draw points on although no scene may contain it."""
    # A copy: where a shape was placed last decides which axes its scene intersects it along.
    result: Any = copy.copy(shape)
    result.place(AxisPool())
    if result.of_triangles:
        MeshSet([result])  # which the mesh joins
    return result
