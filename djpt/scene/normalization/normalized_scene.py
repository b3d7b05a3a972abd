"""The working frame of a scene, about the size of 4 about the origin, and the copy that is rendered in its place."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import NotMovable
from djpt.geometry.aggregate import unseen
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_float, as_vector, may_wait
from djpt.jit.types import Float, Point3f
from djpt.shapes.instance import Instance

if TYPE_CHECKING:
    from djpt.scene.normalization.plugin_copies import PluginCopies
    from djpt.scene.scene import Scene
    from djpt.sensors import Sensor

__all__ = ["Units", "WorkingFrame", "normalized", "normalized_scene", "working_frame"]

SMALLEST, LARGEST = 0.25, 2.0**17
"""Scenes whose bounding box has a diagonal within these bounds are rendered at their own scale."""
SMALLEST_DETAIL = 2.0**-6
"""The least diagonal of the smaller half of the shapes in such a scene."""
FAR = 8
"""A scene is far away if its smaller half is further from the origin than so many of that half's diagonals: rays then
start 2^-10 of its size off surfaces, which hides a thousandth of the light."""
UNIT = 4.0
"""The diagonal of the smaller half of a scaled scene, up to a factor of sqrt(2): that of a ball of radius 1, nearly."""
MANY = 256
"""Of more shapes only the box about all is looked at."""


@dataclass(frozen=True)
class WorkingFrame:
    """The map p -> scale (p - center) from the scene's own coordinates; computed in double precision."""

    scale: float
    """A power of two, so that it rounds nothing."""
    center: tuple[float, float, float]

    @cached_property
    def transform(self) -> ScalarTransform4f:
        """The map as a transform."""
        return ScalarTransform4f().scale(self.scale).translate([-x for x in self.center])

    def point(self, p: Any) -> NDArray[np.float64]:
        """Points (3,) or (N, 3) of the scene, in the frame."""
        return self.scale * (np.asarray(p, np.float64) - np.array(self.center))


def working_frame(scene: Scene) -> WorkingFrame | None:
    """The frame that a scene should be rendered in, or None if its own coordinates will do.

    Two numbers decide: the diagonal of the box about all shapes, and where the smaller half of them is (by number;
    those that don't shine, if there are such). The detail is there, so the frame has its origin there and its unit is
    about a quarter of the size of that half. An endless plane says nothing of either.
    """
    boxes, shining = bounded(scene)
    if not len(boxes):
        return None
    whole, detail = around(boxes), around(smaller_half(boxes if shining.all() else boxes[~shining]))
    size, unit = (float(np.linalg.norm(box[1] - box[0])) for box in (whole, detail))
    center = 0.5 * (detail[0] + detail[1])
    far = float(np.abs(center).max()) > FAR * unit
    usual = size >= SMALLEST and SMALLEST_DETAIL <= unit <= LARGEST
    if not unit > 0 or not (far or not usual):
        return None
    scale = 1.0 if usual else math.ldexp(1.0, -round(math.log2(unit / UNIT)))
    return WorkingFrame(scale, tuple(center.tolist()) if far else (0.0, 0.0, 0.0))


def bounded(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The boxes (N, 2, 3) about the shapes that rays hit, without endless ones, and which shine.

    Of many shapes there is one box, about all.
    """
    shapes = [shape for shape in scene.shapes() if isinstance(shape, Instance) or not unseen(shape)]
    if len(shapes) > MANY:
        boxes, shining = np.array([scene.geometry.bounding_box()]), np.array([False])
    else:
        boxes = np.array([shape.world_box() for shape in shapes]).reshape(-1, 2, 3)
        shining = np.array([shape.emitter() is not None for shape in shapes], bool)
    finite = np.isfinite(boxes).all(axis=(1, 2))
    return boxes[finite], shining[finite]


def around(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The box about all boxes."""
    return np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def smaller_half(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The boxes that are no larger than the median; of two the smaller one."""
    sizes = np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
    return boxes[sizes <= np.sort(sizes)[(len(sizes) - 1) // 2]]


class Units:
    """The inverse of a `WorkingFrame`, in kernels."""

    def __init__(self, frame: WorkingFrame) -> None:
        self._unit, self._center = as_float(1 / frame.scale), as_vector(np.array(frame.center))

    def length(self, x: Float) -> Float:
        """A length."""
        return x * self._unit

    def point(self, p: Point3f) -> Point3f:
        """A point."""
        return dr.fma(p, self._unit, self._center)


COPIED = ("shape", "emitter")
"""The kinds of plugins of which a normalized scene has copies of its own from the beginning."""


def normalized(scene: Scene, sensor: Sensor) -> tuple[Scene, Sensor]:
    """The scene and a sensor as they are rendered: in the working frame if there is one, else themselves."""
    found = None if sensor.moves else normalized_scene(scene)
    if found is None:
        return scene, sensor
    copies, of_scene = found
    try:
        # Anew each time: its film may have changed without the scene's knowledge.
        moved = copies.again(sensor)
    except NotMovable:
        return scene, sensor
    moved.set_bounds(*of_scene.bounding_sphere())
    return of_scene, moved


def normalized_scene(scene: Scene) -> tuple[PluginCopies, Scene] | None:
    """The scene in its working frame, and the copies of its plugins; None if its own coordinates will do, or must."""
    if scene.moves:
        return None  # keyframes are in the scene's coordinates
    if any(emitter.is_moving() for emitter in scene.emitters()):
        return None  # a place in another frame has no gradients
    if scene.normalized == ():
        if recording():
            return None  # what is made now belongs to the recorded function
        scene.normalized = made(scene)
    found: Any = scene.normalized
    return found or None


def made(scene: Scene) -> tuple[PluginCopies, Scene] | None:
    """Compile the normalized scene."""
    frame = working_frame(scene)
    if frame is None:
        return None
    # Most scenes don't need these.
    from djpt.scene.normalization.plugin_copies import PluginCopies

    copies = PluginCopies(frame)
    view = copy.copy(scene)
    view.is_view, view.units = True, Units(frame)
    try:
        view._shapes = [copies.copy_of(shape) for shape in scene._shapes]
        view._emitters = [copies.copy_of(emitter) for emitter in scene._emitters]
        view._sensors = copies.possible(scene._sensors)
        view.named = [(key, copies.copy_of(plugin) if plugin.kind in COPIED else plugin) for key, plugin in scene.named]
    except NotMovable:
        return None
    with may_wait():
        view._compile()
    view.normalized = None
    return copies, view
