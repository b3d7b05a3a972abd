"""The radiance meter: one ray."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

from djpt.core.records import RAY_EPSILON, Ray3f
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.errors import SceneError
from djpt.jit.kernels import as_vector
from djpt.jit.types import Bool, Point2f
from djpt.sensors.base import Sensor
from djpt.sensors.placement import look_along

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["RadianceMeter"]


class RadianceMeter(Sensor):
    """A meter of the radiance that arrives along one ray, with a film of one pixel.

    Parameters, besides those of all sensors: `to_world` (it stands at the origin and looks along +z), or else
    `origin` and `direction`, both together. `to_world` wins if all are given.
    """

    one_pixel = True
    has_neighbours: ClassVar[bool] = False
    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(("origin", "direction"), ParamFlags.NonDifferentiable)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        given = [key for key in ("origin", "direction") if key in props]
        if "to_world" not in props and given:
            if len(given) == 1:
                other = "direction" if given == ["origin"] else "origin"
                raise SceneError(f"{props.node}: '{given[0]}' needs '{other}' as well")
            self.to_world = look_along(props, props.vector("origin"), upwards=0)
        self.parameters_changed(())

    def traverse(self, callback: TraversalCallback) -> None:
        super().traverse(callback)
        callback.put("to_world", self.placing)

    def move_into(self, frame: Frame) -> None:
        self.move_nested(frame)
        self.to_world = frame.moved_unscaled(self.to_world)
        self.parameters_changed(())

    def parameters_changed(self, keys: Sequence[str]) -> None:
        direction = self.to_world.matrix[:3, 2]
        self.origin = as_vector(self.to_world.translation() + RAY_EPSILON * direction)
        self.direction = as_vector(direction)

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        return Ray3f(self.origin, self.direction)


register_sensor("radiancemeter", RadianceMeter)
