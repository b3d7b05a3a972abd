"""Sensors that hand their rays on to others."""

from __future__ import annotations

import copy
import operator
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.records import Ray3f
from djpt.core.transforms.keyframes import Keyframes, MotionTable
from djpt.dispatch.ensemble import Attached, Detached, Ensemble
from djpt.errors import RenderError, SceneError
from djpt.jit.types import Bool, Float, Point2f, UInt32
from djpt.sensors.base import Sensor
from djpt.sensors.placement import placed_apart

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["SensorGroup"]


class SensorGroup(Sensor):
    """A sensor whose rays are those of other sensors, one of them per lane. A subclass calls `hold` when it is made."""

    def hold(self, sensors: Sequence[Sensor], names: Sequence[str], carriers: Sequence[Any]) -> None:
        """Take the sensors: at least one, with their names, and the shapes that carry them, or None.

        Raises:
            SceneError: They measure in different units.
        """
        self.sensors, self.names, self._carriers = list(sensors), list(names), list(carriers)
        self.weight = self.sensors[0].weight
        for name, sensor in zip(self.names, self.sensors, strict=True):
            if sensor.weight != self.weight:
                raise SceneError(
                    f"{self.id()}: '{self.names[0]}' and '{name}' measure in different units "
                    f"({unit(self.sensors[0])} and {unit(sensor)}); put them in separate groups"
                )
            if sensor.moves and isinstance(sensor, SensorGroup):
                raise SceneError(f"{self.id()}: '{name}' moves and is a group itself; nest its sensors in this one")
        self.uses_aperture = any(sensor.uses_aperture for sensor in self.sensors)
        self.forget()

    @property
    def moves(self) -> bool:
        carried = (carrier for carrier in self._carriers if carrier is not None)
        return any(sensor.moves for sensor in self.sensors) or any(shape.motion is not None for shape in carried)

    def hold_copies(self, copy_of: Callable[[Any], Any]) -> None:
        stand_alone = [s.shape is not carrier for s, carrier in zip(self.sensors, self._carriers, strict=True)]
        self._carriers = [copy_of(carrier) for carrier in self._carriers]
        self.sensors = [copy_of(sensor) for sensor in self.sensors]
        for sensor, alone in zip(self.sensors, stand_alone, strict=True):
            if alone:
                sensor.shape = None  # until its shape, which is nobody's, is placed again
        self.forget()

    def delegates(self) -> Sequence[Any]:
        return self.sensors

    def members(self) -> Sequence[Any]:
        return [member for sensor in self.sensors for member in sensor.members()]

    @property
    def has_image_circle(self) -> bool:  # type: ignore[override]
        return any(sensor.has_image_circle for sensor in self.sensors)

    def attached_names(self) -> list[str]:
        return [name for sensor in self.sensors for name in sensor.attached_names()]

    def attached(self) -> Any:
        if self.is_attached or not self.attached_names():
            return self
        view = copy.copy(self)
        view.sensors, view.is_attached = [sensor.attached() for sensor in self.sensors], True
        view.prepare()
        return view

    def forget(self) -> None:
        """Look at the sensors again before the next ray: one of them has changed."""
        self._cameras: Ensemble[Sensor] | None = None
        self._motions: MotionTable | None = None
        self._lookup: Attached | Detached = Detached()
        self._values: list[Any] = []
        """What `_lookup` has copies of."""

    def move_into(self, frame: Frame) -> None:
        self.move_nested(frame)
        self._carriers = [frame.copy_of(carrier) for carrier in self._carriers]
        self.sensors = [frame.copy_of(sensor) for sensor in self.sensors]
        self.forget()

    # ---- on the host -------------------------------------------------------------------

    def viewpoint(self) -> NDArray[np.float64] | None:
        if self.moves:
            return None
        points = [sensor.viewpoint() for sensor in self.sensors]
        first = points[0]
        if first is None or any(p is None or not np.array_equal(p, first) for p in points):
            return None
        return first

    def bbox(self) -> ScalarBoundingBox3f:
        box = ScalarBoundingBox3f()
        for sensor in self.sensors:
            box.expand(sensor.bbox())
        return box

    def near_clip_fraction(self) -> float:
        shares = {sensor.near_clip_fraction() for sensor in self.sensors}
        if len(shares) > 1:
            raise RenderError(f"{self.id()}: distances need cameras with the same 'near_clip' and 'far_clip'")
        return shares.pop()

    def starts(self) -> Sequence[NDArray[np.float64]]:
        return [p for sensor in self.sensors for p in sensor.starts()]

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        for sensor in self.sensors:
            sensor.set_bounds(center, radius)
        self.forget()

    def prepare(self) -> None:
        for sensor, carrier in zip(self.sensors, self._carriers, strict=True):
            # Shapes of the scene have told their sensors; others are nobody's.
            if carrier is not None and sensor.shape is None:
                sensor.shape = placed_apart(carrier)
            sensor.prepare()
        values = [getattr(sensor, name) for sensor in self.sensors for name in sensor.values]
        kept = self._cameras is not None and not self.is_attached and not self.moves
        if kept and all(map(operator.is_, values, self._values)):
            # To a frozen function new arrays would be a new sensor.
            return
        self._values = values
        self._cameras, self._lookup = Ensemble(self.sensors), Detached()
        self._motions = MotionTable(*(keyframes_of(sensor) for sensor in self.sensors)) if self.moves else None
        with dr.resume_grad(when=self.is_attached):
            if self.is_attached:
                places = {(id(s), name): getattr(s, name) for s in self.sensors for name in s.values}
                self._lookup = Attached({place: value for place, value in places.items() if dr.grad_enabled(value)})
            self._lookup.prepare(self._cameras.leaves())

    # ---- in kernels --------------------------------------------------------------------

    def ray_of(
        self, number: UInt32, position: Point2f, aperture_sample: Point2f, time: Float, active: Bool | bool
    ) -> Ray3f:
        """The ray in the world of one of the sensors, by its number, through a position of its own film."""
        if self._cameras is None:
            self.prepare()
        assert self._cameras is not None
        # All sensors of one structure share their code, whatever moves them: so the number finds the motion.
        placement = None if self._motions is None else self._motions.at(time, number)

        def ray_of_sensor(sensor: Sensor) -> Ray3f:
            ray: Ray3f = sensor.ray_through(position, aperture_sample, active).replaced(time=time)
            return ray if placement is None else sensor.placed(ray, placement)

        result: Ray3f = self._cameras.call(number, self._lookup, ray_of_sensor, None)
        return result


STILL = Keyframes(np.arange(2.0), np.ones((2, 3)), np.array([[0, 0, 0, 1.0]] * 2), np.zeros((2, 3)))
"""The keyframes of what stays."""


def keyframes_of(sensor: Sensor) -> Keyframes:
    """The keyframes that move a sensor."""
    keyframes: Keyframes = STILL if sensor.carrier is None else sensor.carrier.keyframes
    return keyframes


def unit(sensor: Sensor) -> str:
    """The quantity that a sensor measures, for a message."""
    return "radiance" if sensor.weight == 1 else "irradiance"
