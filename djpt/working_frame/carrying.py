"""Copies of plugins in a working frame: what has a place or a length is moved and scaled, all else is shared."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import drjit as dr
import numpy as np

from djpt.description.plugin import Plugin
from djpt.description.registry import lookup
from djpt.media.scaling import as_scale
from djpt.shapes.mesh import Mesh
from djpt.transforms import ScalarTransform4f
from djpt.types import Float, Point3f
from djpt.working_frame.frame import Rooted, WorkingFrame
from djpt.working_frame.rescaled import Rescaled

__all__ = ["Carrier"]


class Carrier:
    """Makes copies of plugins in a working frame, one of each.

    Radiance and irradiance stay as they are, the intensity of lights without size follows the square of the scale, and
    what media do per unit of length its inverse.
    """

    def __init__(self, frame: WorkingFrame) -> None:
        self.frame = frame
        self._copies: dict[int, tuple[Any, Any]] = {}

    def plugin(self, plugin: Any) -> Any:
        """The copy of a shape, emitter, sensor or medium; any other plugin itself, and None for None.

        Raises:
            Rooted: it can't be carried.
        """
        if plugin is None or plugin.kind not in ("shape", "emitter", "sensor", "medium", "volume"):
            return plugin
        if id(plugin) not in self._copies:
            if not type(plugin).__module__.startswith("djpt."):
                raise Rooted(f"{plugin.id()} is a script's")
            copied = copy.copy(plugin)
            # The original is kept, so that its id stays taken. (Shapes and their emitters refer to each other.)
            self._copies[id(plugin)] = plugin, copied
            try:
                getattr(self, f"_{plugin.kind}")(copied)
            except Rooted:
                del self._copies[id(plugin)]
                raise
        return self._copies[id(plugin)][1]

    def possible(self, plugins: Iterable[Any]) -> list[Any]:
        """The copies of those plugins that can be carried."""
        copies = []
        for plugin in plugins:
            with suppress(Rooted):
                copies.append(self.plugin(plugin))
        return copies

    def again(self, sensor: Any) -> Any:
        """A new copy of a sensor.

        Raises:
            Rooted: it can't be carried.
        """
        for stale in (sensor, *getattr(sensor, "sensors", ())):
            if stale.shape is None:
                self._copies.pop(id(stale), None)
        copied = self.plugin(sensor)
        copied._film = sensor._film
        return copied

    def _moved(self, to_world: ScalarTransform4f) -> ScalarTransform4f:
        return self.frame.transform @ to_world

    def _turned(self, to_world: ScalarTransform4f) -> ScalarTransform4f:
        """The place of something without a size, moved with the scene."""
        matrix = np.array(to_world.matrix)
        matrix[:3, 3] = self.frame.point(matrix[:3, 3])
        return ScalarTransform4f(matrix)

    # ---- by kind -----------------------------------------------------------------------

    def _shape(self, shape: Any) -> None:
        from djpt.shapes.shapegroup import ShapeGroup

        for derived in ("_alone", "_axes", "large"):
            shape.__dict__.pop(derived, None)
        if isinstance(shape, ShapeGroup):
            shape.named = [(key, apart(member)) for key, member in shape.named]
            for _, member in shape.named:
                self._require_carried(member)
            return
        if hasattr(shape, "group"):
            shape.group = self.plugin(shape.group)
        else:
            self._require_carried(shape)
            for name in ("_emitter", "_sensor", "_interior", "_exterior"):
                setattr(shape, name, self.plugin(getattr(shape, name)))
            for nested in (shape._emitter, shape._sensor):
                if nested is not None:
                    nested.shape = shape
        if isinstance(shape, Mesh):
            move_mesh(shape, self.frame)
        else:
            shape._axes = None
            shape.to_world = self._moved(shape.to_world)

    def _require_carried(self, shape: Any) -> None:
        """Raise `Rooted` if a shape's material looks at places or lengths."""
        require_placeless(shape.bsdf())
        if self.frame.scale != 1 and (shape.bsdf().absorbs or has_heights(shape.bsdf())):
            raise Rooted(f"the material of {shape.id()} has a length")

    def _emitter(self, emitter: Any) -> None:
        if emitter.shape is not None:
            emitter.shape = self.plugin(emitter.shape)
        for name in emitter.children:
            if name != "shape":
                require_placeless(getattr(emitter, name))
        way = EMITTERS.get(emitter_type(emitter))
        if way is None and not (emitter.from_infinity or emitter.on_shape):
            raise Rooted(f"{emitter.id()} isn't known")
        if way is not None:
            way(self, emitter)

    def point_light(self, light: Any) -> None:
        """Move a light at a point."""
        light.position = Point3f(*self.frame.point(light.exact_position()).tolist())
        light.intensity = Rescaled.of(light.intensity, self.frame.scale**2)

    def spot(self, light: Any) -> None:
        """Move a light at a point that has a direction."""
        light.to_world = self._turned(light.to_world)
        light.parameters_changed(("to_world",))
        light.intensity = Rescaled.of(light.intensity, self.frame.scale**2)

    def projector(self, light: Any) -> None:
        """Move a projector."""
        light.to_world = self._turned(light.to_world)
        light.parameters_changed(("to_world",))
        light.irradiance = Rescaled.of(light.irradiance, self.frame.scale**2)

    def _sensor(self, sensor: Any) -> None:
        sensor._medium = self.plugin(sensor._medium)
        if type(sensor).__name__ not in SENSORS:
            raise Rooted(f"{sensor.id()} isn't known")
        if sensor.shape is not None:
            sensor.shape = self.plugin(sensor.shape)
            return
        if hasattr(sensor, "sensors"):
            sensor._carriers = [self.plugin(carrier) for carrier in sensor._carriers]
            sensor.sensors = [self.plugin(nested) for nested in sensor.sensors]
            sensor.forget()
            return
        if hasattr(sensor, "target"):
            self._target(sensor)
        scale = self.frame.scale
        sensor.to_world = self._turned(sensor.to_world)
        for name in LENGTHS:
            value = getattr(sensor, name, None)
            if value is not None:
                setattr(sensor, name, Float(value[0] * scale) if dr.is_array_v(value) else value * scale)
        if type(sensor).__name__ == "Orthographic":
            sensor.to_world = sensor.to_world.scale([scale, scale, 1])
        sensor.parameters_changed(())

    def _target(self, sensor: Any) -> None:
        """Move what a distant sensor looks at."""
        sensor._shape = self.plugin(sensor._shape)
        if sensor._point is not None:
            sensor._point = self.frame.point(sensor._point)

    def _medium(self, medium: Any) -> None:
        if type(medium).__name__ not in MEDIA:
            raise Rooted(f"{medium.id()} isn't known")
        require_placeless(medium.phase)
        if medium.emits() and self.frame.scale != 1:
            raise Rooted(f"{medium.id()} glows per unit of length")
        medium.scale = as_scale(medium.scale / self.frame.scale)
        for name in ("albedo", "sigma_t", "emission"):
            setattr(medium, name, self.plugin(getattr(medium, name)))
        medium.parameters_changed(())

    def _volume(self, volume: Any) -> None:
        if volume.is_constant:
            require_placeless(volume)
            return
        if type(volume).__name__ != "GridVolume":
            raise Rooted(f"{volume.id()} isn't known")
        volume.to_world = self._moved(volume.to_world)
        volume.parameters_changed(("to_world",))


LENGTHS = ("_near_clip", "_far_clip", "_focus_distance", "aperture_radius")
"""The lengths that sensors have."""
SENSORS = ("Perspective", "ThinLens", "Orthographic", "RadianceMeter", "IrradianceMeter", "Distant", "Batch")
MEDIA = ("Homogeneous", "Heterogeneous")
"""The classes of sensors and media that can be carried."""

EMITTERS: dict[str, Callable[[Carrier, Any], None]] = {
    "point": Carrier.point_light,
    "spot": Carrier.spot,
    "projector": Carrier.projector,
}
"""How lights without a size are carried."""


def emitter_type(emitter: Any) -> str:
    """The name among EMITTERS of a light without a size, or an empty one."""
    return next((name for name in EMITTERS if type(emitter) is lookup("emitter", name)), "")


def apart(shape: Any) -> Any:
    """A copy of a shape of a group, in the group's own space, that can belong to another scene."""
    copied = copy.copy(shape)
    copied.__dict__.pop("_alone", None)
    if isinstance(copied, Mesh):
        copied.leave()
    else:
        copied._axes = None
    return copied


def move_mesh(mesh: Mesh, frame: WorkingFrame) -> None:
    """Move a copy of a mesh, which becomes its own."""
    mesh.leave(frame.point(mesh.exact_positions()).astype(np.float32))


def require_placeless(plugin: Any) -> None:
    """Raise `Rooted` if a plugin, or one nested in it, may look at places in the world."""
    if not isinstance(plugin, Plugin):
        return
    if not type(plugin).__module__.startswith("djpt."):
        raise Rooted(f"{plugin.id()} is a script's")
    if plugin.kind == "volume" and not getattr(plugin, "is_constant", False):
        raise Rooted(f"{plugin.id()} varies in space")
    for name in plugin.children:
        require_placeless(getattr(plugin, name))


def has_heights(plugin: Any) -> bool:
    """Whether a plugin, or one nested in it, is a bump map, whose heights are lengths."""
    if not isinstance(plugin, Plugin):
        return False
    return type(plugin).__name__ == "BumpMap" or any(has_heights(getattr(plugin, name)) for name in plugin.children)
