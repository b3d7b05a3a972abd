"""The arguments that verbs and integrators share: a scene, and one of its sensors."""

from __future__ import annotations

from typing import Any

from djpt.core.numeric import whole
from djpt.errors import RenderError
from djpt.scene.scene import Scene
from djpt.sensors.base import Sensor

__all__ = ["find_sensor", "require_scene"]


def require_scene(scene: Any) -> Scene:
    """The scene itself; raises `RenderError` if it isn't one."""
    if not isinstance(scene, Scene):
        raise RenderError(f"render() expects a scene from load_dict(), found {type(scene).__name__}")
    return scene


def find_sensor(scene: Scene, sensor: Any) -> Sensor:
    """The sensor to render: one of the scene, by number, or another one, which is told how large the scene is."""
    require_scene(scene)
    sensors = scene.sensors()
    if not isinstance(sensor, Sensor):
        number = whole(sensor)
        if number is None:
            raise RenderError(f"'sensor' must be an index or a sensor, found {type(sensor).__name__}")
        if not sensors:
            raise RenderError("the scene has no sensor: add one, for example {'type': 'perspective'}")
        if not 0 <= number < len(sensors):
            raise RenderError(f"there is no sensor {number}: the scene has {len(sensors)}, numbered from 0")
        sensor = sensors[number]
    found: Sensor = sensor
    if found.on_shape and found.shape is None:
        raise RenderError(f"'{found.id()}' must be nested in a shape of the scene to be rendered")
    if found not in sensors:
        found.set_bounds(*scene.bounding_sphere())
    return found
