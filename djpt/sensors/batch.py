"""Several sensors side by side in one film."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.errors import ParameterError, RenderError, SceneError
from djpt.jit.kernels import maximum, minimum
from djpt.jit.types import Bool, Float, Point2f, UInt32
from djpt.sensors.base import Sensor
from djpt.sensors.group import SensorGroup
from djpt.sensors.placement import require_area

__all__ = ["Batch"]


class Batch(SensorGroup):
    """Many views in one film: it is divided into equal parts from left to right, one per sensor.

    All are traced by one kernel, however many there are of one kind.

    Parameters: those of all sensors but `to_world`, and any number of nested sensors, or shapes that carry one, in
    order, all of which may move. The film's width must be a multiple of their number. The film, the sampler and the
    shutter of the batch count; the films of nested sensors get the size of their parts (a field of view along x keeps
    its meaning). Filters wider than a pixel mix neighbouring views along the seams.

    All sensors must have the same unit: cameras and radiance meters can stand beside each other, irradiance meters
    only beside their like. A batch whose cameras stand apart is taken to stand outside of all bodies that absorb.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        if "to_world" in props:
            raise props.error("to_world", "can't be given: place the sensors of the batch")
        super().__init__(props)
        nested = dict(props.children("sensor")) | dict(props.children("shape"))
        held = Held([], [], [])
        order = props.keys()
        for key in sorted(nested, key=order.index):
            held.add(props, key, nested[key])
        if not held.sensors:
            raise SceneError(f"{props.node}: a batch needs at least one nested sensor")
        self.hold(held.sensors, held.names, held.carriers)
        try:
            self._divide()
        except ParameterError as error:
            raise SceneError(f"{props.node}: {error}") from None

    def _divide(self) -> None:
        """Give every sensor's film the size of its part."""
        width, height = self.film().size()
        count = len(self.sensors)
        if width % count:
            raise ParameterError(f"the film's width, {width}, must be a multiple of the number of sensors, {count}")
        for sensor in self.sensors:
            part = (width // count, height)
            if (tuple(sensor.film().size()), tuple(sensor.film().crop_size())) != (part, part):
                sensor.resize_film(*part)

    # ---- parameters --------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        super().traverse(callback)
        for name, sensor in zip(self.names, self.sensors, strict=True):
            callback.put(name, sensor)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        self._divide()
        self.forget()

    # ---- motion ------------------------------------------------------------------------

    def parts(self) -> Sequence[Any]:
        film = self.film()
        if tuple(film.crop_size()) != tuple(film.size()):
            raise RenderError(f"{self.id()}: derivatives by motion need the whole film of a batch, found a crop window")
        parts = [copy.copy(sensor) for sensor in self.sensors]
        for number, part in enumerate(parts):
            part.canvas, part.column = film, number * (film.size()[0] // len(parts))
        return parts

    # ---- in kernels --------------------------------------------------------------------

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        return self.ray_at(Float(self.shutter_open() if self.moves else 0), film_position, aperture_sample, active)

    def ray_at(
        self, time: Float, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True
    ) -> Ray3f:
        part = self._part(film_position)
        x = film_position.x * len(self.sensors) - part
        return self.ray_of(UInt32(part), Point2f(x, film_position.y), aperture_sample, time, active)

    def looks_through(self, pixel: UInt32, film_position: Point2f) -> UInt32 | None:
        return UInt32(self._part(film_position))

    def _part(self, film_position: Point2f) -> Float:
        """The number of the part; samples beside the film, of its border, belong to the outermost ones."""
        count = len(self.sensors)
        part: Float = minimum(maximum(dr.floor(film_position.x * count), 0), count - 1)
        return part


@dataclass
class Held:
    """The sensors of a description, with their names and the shapes that carry them."""

    sensors: list[Sensor]
    names: list[str]
    carriers: list[Any]

    def add(self, props: Properties, key: str, plugin: Any) -> None:
        """Add an entry: a sensor, or a shape that has one."""
        carrier = None
        if plugin.kind == "shape":
            carrier, plugin = plugin, plugin.sensor()
            if plugin is None:
                raise props.error(key, "is a shape without a sensor")
            require_area(carrier, "irradiancemeter")
        elif plugin.on_shape:
            raise props.error(key, "must be nested in a shape; nest the shape in the batch")
        # Mitsuba names them by their ids: for the sensor of a shape that is `sensor`.
        name = plugin.id().rpartition(".")[2]
        self.names.append(key if name in self.names else name)
        self.sensors.append(plugin)
        self.carriers.append(carrier)


register_sensor("batch", Batch)
