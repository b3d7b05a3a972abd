"""Lights with a place and a direction: the parameters and methods that they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.transforms import ScalarTransform4f, as_transform
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.emitters.base import Emitter
from djpt.errors import ParameterError, SceneError
from djpt.jit.kernels import as_vector
from djpt.jit.types import Point2f, Vector3f

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["OnImage", "OrientedEmitter"]

PLACE = ("position", "left", "up", "forward")
"""The values that kernels read of a `to_world`."""


class OrientedEmitter(Emitter):
    """A light that looks along its local +z axis.

    Parameters: `to_world` (rotation, reflection, translation; a uniform scale has no effect; default identity).
    """

    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(PLACE, ParamFlags.Differentiable)
    motions: ClassVar[tuple[str, ...]] = PLACE
    can_move: ClassVar[bool] = True
    """Whether its `to_world` may be animated."""
    motion_flags: ClassVar[ParamFlags] = ParamFlags.Differentiable | ParamFlags.Discontinuous
    """The flags of `to_world`: shadows have edges, which move with the light."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.motion = props.animation("to_world") if self.can_move else None
        self.to_world = props.transform("to_world")
        if self.motion is not None:
            with props.naming("to_world"):
                self.motion.demand("rigid", "must not scale: an animated light has no size")
        with props.naming("to_world"):
            require_similar(self.to_world)
        self._place()

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.share, attribute="share")
        for name, flags in self.values.items():
            if flags.differentiable and name not in PLACE:
                callback.put(name, getattr(self, name), flags)
        for name in self.children:
            callback.put(name, getattr(self, name))
        callback.put("to_world", self.placing, self.motion_flags)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name != "to_world":
            return super().check_parameter(name, value)
        transform = self._attached(value) if dr.grad_enabled(value) else as_transform(value)
        require_similar(transform)
        return transform

    def _attached(self, value: Any) -> ScalarTransform4f:
        """A `to_world` with gradients."""
        if not self.motion_flags.differentiable:
            raise ParameterError(f"{self.id()}.to_world: gradients with respect to this parameter aren't available")
        from djpt.core.transforms.lanes import Transform4f
        from djpt.shapes.silhouettes.moving import AttachedTransform  # few lights move

        return AttachedTransform(Transform4f(value))

    def parameters_changed(self, keys: Sequence[str]) -> None:
        if "to_world" in keys:
            self._place()

    def move_nested(self, frame: Frame) -> None:
        """Move the light's place, too: it has no size."""
        super().move_nested(frame)
        self.to_world = frame.moved_unscaled(self.to_world)
        self._place()

    def _place(self) -> None:
        """Compute the light's position and the unit vectors of its axes, which kernels read."""
        self.position: Any
        lanes = getattr(self.to_world, "lanes", None)
        if lanes is None:
            linear = self.to_world.matrix[:3, :3]
            axes = linear / np.linalg.norm(linear, axis=0)
            self.position = as_vector(self.to_world.translation())
            self.left, self.up, self.forward = (as_vector(axis) for axis in axes.T)
            return
        with dr.resume_grad():
            x, y, z, self.position = (Vector3f(*(lanes.matrix[i, k] for i in range(3))) for k in range(4))
            self.left, self.up, self.forward = dr.normalize(x), dr.normalize(y), dr.normalize(z)

    # ---- in kernels --------------------------------------------------------------------

    def world_to_local(self, v: Vector3f) -> Vector3f:
        """A world-space vector in the light's space: its components along the axes."""
        return Vector3f(*(axis.x * v.x + axis.y * v.y + axis.z * v.z for axis in (self.left, self.up, self.forward)))

    def local_to_world(self, v: Vector3f) -> Vector3f:
        """A vector of the light's space in world space."""
        return self.left * v.x + self.up * v.y + self.forward * v.z


class OnImage:
    """A place of a projected texture: what a texture is evaluated at, with nothing but uv."""

    def __init__(self, uv: Point2f) -> None:
        self.uv = uv


def require_similar(transform: ScalarTransform4f) -> None:
    """Raise `SceneError` if a transform changes angles."""
    linear = transform.matrix[:3, :3]
    squares = linear.T @ linear
    size = squares.trace() / 3
    if not (np.abs(squares - size * np.eye(3)) <= 1e-3 * size).all() or size == 0:
        raise SceneError("must not shear, nor scale differently along different axes: a light has no size")
