"""Instances: a group of shapes placed anew without being copied."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.errors import ParameterError, SceneError
from djpt.shapes.axes import AxisPool
from djpt.shapes.base import Shape
from djpt.shapes.shapegroup import ShapeGroup

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Instance"]


class Instance(Shape):
    """The shapes of a `shapegroup`, moved by `to_world`.

    Parameters: a nested `shapegroup`, or a reference to one (`group`), and `to_world` (affine, default
    identity), which maps from the group's space. BSDFs are those of the group's shapes.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        # Not `Shape.__init__`: BSDFs, flips and so on belong to the group's shapes.
        Plugin.__init__(self, props)
        nested = props.children("shape")
        if len(nested) != 1 or not isinstance(nested[0][1], ShapeGroup):
            found = ", ".join(f"'{key}' ({type(shape).__name__})" for key, shape in nested) or "none"
            raise SceneError(
                f"{props.node}: an 'instance' needs one 'shapegroup' or a reference to one, found: {found}"
            )
        self.group: ShapeGroup = nested[0][1]
        self.motion = props.animation("to_world")
        self.to_world: ScalarTransform4f = props.transform("to_world")
        if self.motion is not None:
            with props.naming("to_world"):
                self.check_motion()
        try:
            self._check_shapes(self.to_world)
        except ParameterError as error:
            raise SceneError(f"{props.node}: {error}") from None

    def _check_shapes(self, to_world: ScalarTransform4f) -> None:
        """Raise `ParameterError` if one of the group's analytic shapes can't be copied with the transform."""
        for shape in self.group.shapes:
            if not shape.of_triangles:
                shape.check_parameter("to_world", to_world @ shape.to_world)

    def can_be_followed(self) -> bool:
        return all(shape.silhouette_discontinuity_types() for shape in self.group.shapes)

    def check_parameter(self, name: str, value: Any) -> Any:
        value = super().check_parameter(name, value)
        self._check_shapes(value)
        return value

    def traverse(self, callback: TraversalCallback) -> None:
        # As in Mitsuba, the group's parameters belong to the group, which is a node of the scene.
        callback.put("to_world", self.placing, self.motion_flags())

    def check_motion(self) -> None:
        self.motion.demand("unmirrored", "must not mirror an instance: mirror what moves")
        if any(shape.is_medium_transition() for shape in self.group.shapes):
            raise SceneError("can't move a shape that bounds a medium")

    def bsdf(self) -> None:
        """None: BSDFs belong to the shapes of the group."""

    def primitive_count(self) -> int:
        return 0

    def effective_primitive_count(self) -> int:
        return self.group.primitive_count()

    def move_nested(self, frame: Frame) -> None:
        self.group = frame.copy_of(self.group)

    def place(self, pool: AxisPool) -> None:
        """Do nothing: what kernels read of an instance belongs to the scene's geometry."""

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        matrix = self.to_world.matrix
        # <d, L p + t> = <L^T d, p> + <d, t>
        local = matrix[:3, :3].T @ direction
        length = float(np.linalg.norm(local))
        low, high = self.group.interval(local / length)
        shift = float(matrix[:3, 3] @ direction)
        return low * length + shift, high * length + shift


register_shape("instance", Instance)
