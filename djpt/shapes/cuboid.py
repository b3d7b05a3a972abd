"""The box along the coordinate axes, given by two corners."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.errors import ParameterError
from djpt.jit.types import Point3f
from djpt.shapes.cube import Cube

__all__ = ["Cuboid"]


class Cuboid(Cube):
    """All points on the boundary of min <= p <= max, mapped by `to_world`; faces, uv and normals are the cube's.

    Parameters: `min` (default (-1, -1, -1)), `max` (default (1, 1, 1)), `to_world` (affine, default identity),
    `flip_normals` (default false). Without a rotation it is the cheapest closed shape: nothing is projected.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        low, high = props.vector("min", (-1, -1, -1)), props.vector("max", (1, 1, 1))
        if not (low < high).all():
            found = f"{high.tolist()} and {low.tolist()}"
            raise props.error("max", f"must be greater than 'min' in every coordinate, found {found}")
        self._placed = self.to_world
        self.min, self.max = Point3f(*low.tolist()), Point3f(*high.tolist())
        self._compose()

    def _compose(self) -> None:
        """Set the transform that takes the cube [-1, 1]^3 to this box, from the parameters."""
        low, high = (np.array(dr.detach(corner), np.float64).ravel() for corner in (self.min, self.max))
        if not (low < high).all():
            found = f"{high.tolist()} and {low.tolist()}"
            raise ParameterError(f"{self.id()}: 'max' must be greater than 'min' in every coordinate, found {found}")
        lanes = getattr(self._placed, "lanes", None)
        if lanes is None and not dr.grad_enabled(self.min, self.max):
            self.to_world = self._placed.translate((low + high) / 2).scale((high - low) / 2)
        else:
            from djpt.core.transforms.lanes import Transform4f
            from djpt.shapes.silhouettes.moving import AttachedTransform

            placed = Transform4f(self._placed.matrix) if lanes is None else lanes
            middle, half = 0.5 * (self.min + self.max), 0.5 * (self.max - self.min)
            self.to_world = AttachedTransform(placed @ Transform4f().translate(middle).scale(half))

    def attached_parameter(self, name: str, value: Any) -> Any:
        return value if name in ("min", "max") and self.can_be_followed() else super().attached_parameter(name, value)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        self._compose()

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        moves = self.motion_flags()
        callback.put("min", self.min, moves)
        callback.put("max", self.max, moves)
        if self.motion is None:
            callback.put("to_world", self._placed, moves, attribute="_placed")


register_shape("cuboid", Cuboid)
