"""Several sensors side by side in one film."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.dispatch.ensemble import Detached, Ensemble
from djpt.errors import ParameterError, RenderError, SceneError
from djpt.geometry.bounding_box import ScalarBoundingBox3f
from djpt.kernels import maximum, minimum
from djpt.records import Ray3f
from djpt.sensors.base import Sensor
from djpt.sensors.placement import placed_apart, require_area
from djpt.types import Bool, Point2f, UInt32

__all__ = ["Batch"]


class Batch(Sensor):
    """Many views in one film: it is divided into equal parts from left to right, one per sensor.

    All are traced by one kernel, however many there are of one kind.

    Parameters: those of all sensors but `to_world`, and any number of nested sensors, or shapes that carry one, in
    order. The film's width must be a multiple of their number. The film, the sampler and the shutter of the batch
    count; the films of nested sensors get the size of their parts (a field of view along x keeps its meaning).
    Filters wider than a pixel mix neighbouring views along the seams.

    All sensors must have the same unit: cameras and radiance meters can stand beside each other, irradiance meters
    only beside their like. A batch whose cameras stand apart is taken to stand outside of all bodies that absorb.
    """

    def __init__(self, props: Properties) -> None:
        if "to_world" in props:
            raise props.error("to_world", "can't be given: place the sensors of the batch")
        super().__init__(props)
        nested = dict(props.children("sensor")) | dict(props.children("shape"))
        self.sensors: list[Sensor] = []
        self.names: list[str] = []
        self._carriers: list[Any] = []
        order = props.keys()
        for key in sorted(nested, key=order.index):
            self._add(props, key, nested[key])
        if not self.sensors:
            raise SceneError(f"{props.node}: a batch needs at least one nested sensor")
        self.weight = self.sensors[0].weight
        for name, sensor in zip(self.names, self.sensors, strict=True):
            if sensor.weight != self.weight:
                raise SceneError(
                    f"{props.node}: '{self.names[0]}' and '{name}' measure in different units "
                    f"({unit(self.sensors[0])} and {unit(sensor)}); put them in batches of their own"
                )
        self.uses_aperture = any(sensor.uses_aperture for sensor in self.sensors)
        self._cameras: Ensemble[Sensor] | None = None
        self._lookup = Detached()
        try:
            self._divide()
        except ParameterError as error:
            raise SceneError(f"{props.node}: {error}") from None

    def _add(self, props: Properties, key: str, plugin: Any) -> None:
        if plugin.kind == "shape":
            if plugin.sensor() is None:
                raise props.error(key, "is a shape without a sensor")
            require_area(plugin, "irradiancemeter")
            self._carriers.append(plugin)
            plugin = plugin.sensor()
        elif plugin.on_shape:
            raise props.error(key, "must be nested in a shape; nest the shape in the batch")
        else:
            self._carriers.append(None)
        self.sensors.append(plugin)
        # Mitsuba names them by their ids: for the sensor of a shape that is `sensor`.
        name = plugin.id().rpartition(".")[2]
        self.names.append(key if name in self.names else name)

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
        self._cameras = None

    # ---- on the host -------------------------------------------------------------------

    def viewpoint(self) -> NDArray[np.float64] | None:
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

    def near_share(self) -> float:
        shares = {sensor.near_share() for sensor in self.sensors}
        if len(shares) > 1:
            raise RenderError(f"{self.id()}: distances need cameras with the same 'near_clip' and 'far_clip'")
        return shares.pop()

    def starts(self) -> Sequence[NDArray[np.float64]]:
        return [p for sensor in self.sensors for p in sensor.starts()]

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        for sensor in self.sensors:
            sensor.set_bounds(center, radius)
        self._cameras = None

    def prepare(self) -> None:
        for sensor, carrier in zip(self.sensors, self._carriers, strict=True):
            # Shapes of the scene have told their sensors; others are nobody's.
            if carrier is not None and sensor.shape is None:
                sensor.shape = placed_apart(carrier)
            sensor.prepare()
        self._cameras, self._lookup = Ensemble(self.sensors), Detached()
        self._lookup.prepare(self._cameras.leaves())

    # ---- in kernels --------------------------------------------------------------------

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        if self._cameras is None:
            self.prepare()
        assert self._cameras is not None
        last = len(self.sensors) - 1
        x = film_position.x * len(self.sensors)
        # Samples beside the film, of its border, belong to the outermost parts.
        part = minimum(maximum(dr.floor(x), 0), last)
        position = Point2f(x - part, film_position.y)
        return self._cameras.call(
            UInt32(part), self._lookup, lambda sensor: sensor.ray_through(position, aperture_sample, active), None
        )


def unit(sensor: Sensor) -> str:
    """The quantity that a sensor measures, for a message."""
    return "radiance" if sensor.weight == 1 else "irradiance"


register_sensor("batch", Batch)
