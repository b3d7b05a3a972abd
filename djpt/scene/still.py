"""A scene at one moment: copies of what moves, placed, in which nothing knows of time."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.core.transforms import ScalarTransform4f
from djpt.description.animation import AnimatedTransform4f
from djpt.description.registry import name_of
from djpt.errors import RenderError
from djpt.jit.kernels import may_wait
from djpt.jit.types import Float, Point3f

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["StillScene", "still_scene"]


class StillScene:
    """The copies that make up a scene at one moment.

    All shapes, emitters and sensors are copied, since each belongs to one scene: what covers them is shared, and so
    are the gradients of materials.
    """

    def __init__(self, scene: Scene, time: float, attached: bool, moment: Float | None = None) -> None:
        """With `attached`, what moves is attached to keyframes with gradients, and to the time if `moment` gives it."""
        self._time, self._attached, self._moment = time, attached, moment
        self._copies: dict[int, tuple[Any, Any]] = {}
        view = copy.copy(scene)
        view._shapes = [self.copy_of(shape) for shape in scene._shapes]
        view._emitters = [self.copy_of(emitter) for emitter in scene._emitters]
        view._sensors = [self.copy_of(sensor) for sensor in scene._sensors]
        view.named = [
            (key, self.copy_of(plugin) if plugin.kind in ("shape", "emitter", "sensor") else plugin)
            for key, plugin in scene.named
        ]
        view.moves, view.is_view = False, False
        view.in_time = any(emitter.in_time for emitter in view._emitters)
        with may_wait():
            view._compile()
            for sensor in view._sensors:
                # What is averaged over the cross-section of the scene is so at all moments over the same one.
                sensor.set_bounds(*scene.bounding_sphere())
        self.scene = view

    def copy_of(self, plugin: Any) -> Any:
        """The copy of a shape, an emitter or a sensor: always the same."""
        if plugin is None:
            return None
        if id(plugin) not in self._copies:
            copied = copy.copy(plugin)
            self._copies[id(plugin)] = plugin, copied
            getattr(self, f"_{plugin.kind}")(copied)
        return self._copies[id(plugin)][1]

    def _transform(self, motion: AnimatedTransform4f) -> Any:
        """The transform of what moves: attached to keyframes with gradients, else on the host."""
        if self._attached and (self._moment is not None or motion.is_attached()):
            from djpt.core.transforms.lanes import Transform4f

            return Transform4f(motion.attached_matrix_at(self._time, self._moment))
        return motion.eval_scalar(self._time)

    def _shape(self, shape: Any) -> None:
        motion, shape.motion = shape.motion, None
        attached = shape.__dict__.get("vertex_positions")
        if shape.deforms:
            shape.at_time(self._time)
        shape.leave()
        if attached is not None and dr.grad_enabled(attached):
            if motion is not None:
                raise RenderError(f"'{shape.id()}' moves: there are derivatives by its keyframes, not by its vertices")
            shape.vertex_positions = attached
        if name_of(type(shape)) == "shapegroup":
            shape.named = [(key, self.copy_of(inner)) for key, inner in shape.named]
            return
        if name_of(type(shape)) == "instance":
            shape.group = self.copy_of(shape.group)
        else:
            shape._emitter, shape._sensor = self.copy_of(shape._emitter), self.copy_of(shape._sensor)
        for nested in (shape.emitter(), shape.sensor()):
            if nested is not None:
                nested.shape = shape
        if motion is None:
            return
        placed = self._transform(motion)
        if shape.of_triangles:
            place_mesh(shape, placed)
        elif isinstance(placed, ScalarTransform4f):
            shape.to_world = shape.check_parameter("to_world", placed @ shape.to_world)
        else:
            shape.to_world = shape.check_parameter("to_world", type(placed)(placed.matrix @ matrix(shape.to_world)))

    def _emitter(self, emitter: Any) -> None:
        motion, emitter.motion = emitter.motion, None
        if motion is None:
            return
        placed = self._transform(motion)
        if hasattr(emitter, "to_world"):
            emitter.to_world = emitter.check_parameter("to_world", placed)
            emitter.parameters_changed(("to_world",))
        else:
            emitter.position = Point3f(*(Float(x) for x in placed.translation()))

    def _sensor(self, sensor: Any) -> None:
        motion, sensor.motion = sensor.motion, None
        sensor.hold_copies(self.copy_of)
        if motion is None:
            return
        sensor.to_world = sensor.check_parameter("to_world", self._transform(motion))
        sensor.parameters_changed(("to_world",))


def matrix(transform: ScalarTransform4f) -> Any:
    """A transform of the host as a Dr.Jit matrix."""
    from djpt.jit.types import Matrix4f

    return Matrix4f(transform.matrix.tolist())


def place_mesh(mesh: Any, placed: Any) -> None:
    """Move the vertices of a mesh, a copy, and its normals."""
    host = placed if isinstance(placed, ScalarTransform4f) else ScalarTransform4f(placed)
    own = mesh.positions
    positions = host.transform_point(own.astype(np.float64)).astype(np.float32)
    if mesh.normals is not None:
        normals = host.transform_normal(mesh.normals.astype(np.float64))
        mesh.normals = (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)).astype(np.float32)
        mesh.__dict__.pop("vertex_normals", None)
    mesh.leave(positions)
    if host is not placed:
        mesh.attach_to(placed, own)


def still_scene(scene: Scene, time: float, attached: bool = False) -> Scene:
    """The scene at a time, in which nothing moves; edits of the one don't reach the other."""
    return StillScene(scene, time, attached).scene
