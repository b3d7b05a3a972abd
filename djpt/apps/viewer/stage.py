"""The scene being viewed, and everything about it that can be changed while it is rendered."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import djpt
from djpt.apps.orbit import OrbitCamera
from djpt.apps.viewer.controls import changed, controls
from djpt.core.transforms import ScalarTransform4f
from djpt.errors import RenderError, near_miss
from djpt.integrators.base import Integrator
from djpt.rendering.image import channel_names
from djpt.rendering.settings import find_integrator
from djpt.scene.scene import find_sensor
from djpt.sensors.orthographic import Orthographic
from djpt.sensors.projective import ProjectiveCamera

__all__ = ["LAYERS", "Stage"]

LAYERS = {
    "light": "",
    "error": "",
    "albedo": "albedo",
    "normal": "sh_normal",
    "depth": "depth",
    "position": "position",
    "uv": "uv",
    "shape": "shape_index",
}
"""The layers that can be shown: the image, its error, and variables of the integrator `aov`."""


class Stage:
    """A loaded scene with a camera that moves, a window of pixels, and a layer.

    Args:
        description: the scene's dict.
        sensor: the number of the camera.

    Raises:
        RenderError: The sensor takes no pictures, or there is no sensor with this number.
    """

    def __init__(self, description: Mapping[str, Any], sensor: int = 0) -> None:
        self.scene = djpt.load_dict(dict(description) if type(description) is dict else description)
        self.params = djpt.traverse(self.scene)
        self.sensor = find_sensor(self.scene, sensor)
        if not isinstance(self.sensor, ProjectiveCamera):
            raise RenderError(f"'{self.sensor.id()}' takes no pictures: choose a camera with --sensor")
        self.number = sensor
        self.layer = "light"
        self._aovs: dict[str, Integrator] = {}
        names = self.params.names_of(self.sensor)
        self._to_world = next(name for name in names if name.endswith("to_world"))
        film = self.params.names_of(self.sensor.film())
        self._crop = {name.rpartition(".")[2]: name for name in film}
        self.camera = self.home = OrbitCamera.of(self.scene, self.sensor)
        """The camera's current placement, and its placement in the scene."""

    # ---- what is rendered --------------------------------------------------------------------

    @property
    def integrator(self) -> Integrator:
        """The integrator of the layer that is shown."""
        variable = LAYERS[self.layer]
        if not variable:
            return find_integrator(self.scene, None)
        if variable not in self._aovs:
            self._aovs[variable] = djpt.load_dict({"type": "aov", "aovs": f"x:{variable}"})
        return self._aovs[variable]

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the image's channels."""
        return channel_names(self.scene, self.number, self.integrator)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the film in pixels."""
        width, height = self.sensor.film().size()
        return int(width), int(height)

    @property
    def window(self) -> tuple[int, int, int, int]:
        """Column and row of the first pixel that is rendered, and the number of columns and rows."""
        (x, y), (width, height) = self.sensor.film().crop_offset(), self.sensor.film().crop_size()
        return int(x), int(y), int(width), int(height)

    def controls(self) -> list[dict[str, Any]]:
        """The parameters that the page shows: see `djpt.apps.viewer.controls.controls`."""
        return controls(self.params)

    # ---- what changes it ---------------------------------------------------------------------

    def show(self, layer: Any) -> None:
        """Show another layer."""
        if not isinstance(layer, str) or layer not in LAYERS:
            name = str(layer)[:40]
            raise RenderError(f"unknown layer '{name}'{near_miss(name, LAYERS)}")
        self.layer = layer

    def change(self, key: Any, numbers: Any) -> None:
        """Set a parameter to another value."""
        changed(self.params, key, numbers)

    def crop(self, x: int, y: int, width: int, height: int) -> None:
        """Render only a window, clipped to the film; the whole film if the window is empty."""
        columns, rows = self.size
        left, top = min(max(x, 0), columns), min(max(y, 0), rows)
        right, bottom = min(max(x + width, 0), columns), min(max(y + height, 0), rows)
        if right <= left or bottom <= top:
            left, top, right, bottom = 0, 0, columns, rows
        # Both at once: neither need fit with the other's old value.
        self.params.update(
            {self._crop["crop_offset"]: (left, top), self._crop["crop_size"]: (right - left, bottom - top)}
        )

    def turn(self, yaw: float, pitch: float) -> None:
        """Orbit the camera about its target, by angles in radians."""
        self.hold(self.camera.turned(yaw, pitch))

    def shift(self, right: float, upward: float) -> None:
        """Move the camera sideways, by multiples of its distance."""
        self.hold(self.camera.shifted(right * self.camera.distance, upward * self.camera.distance))

    def approach(self, factor: float) -> None:
        """Multiply the distance, or without perspective the size of what is seen, by a factor from 1/4 to 4."""
        factor = min(max(factor, 0.25), 4.0)
        orthographic = isinstance(self.sensor, Orthographic)
        self.hold(self.camera.scaled(factor) if orthographic else self.camera.approached(factor))

    def return_home(self) -> None:
        """Reset the camera to its placement in the scene."""
        self.hold(self.home)

    def hold(self, camera: OrbitCamera) -> None:
        """Put the camera somewhere.

        Raises:
            RenderError: The camera is so far away, or so near to its target, that its position isn't finite.
        """
        if not (np.isfinite(camera.to_world).all() and np.isfinite(camera.distance) and camera.distance > 0):
            raise RenderError("the camera can't move there: its position would no longer be finite")
        self.params.update({self._to_world: ScalarTransform4f(camera.to_world)})
        self.camera = camera
