"""A diffuse floor with two spheres, lit and seen in every way that there is."""

from __future__ import annotations

from typing import Any

from djpt.core.transforms import ScalarTransform4f as T

__all__ = ["floor_scene"]

LAMP = {
    "type": "rectangle",
    "to_world": T().look_at(origin=[-2, 3, 2.5], target=[0, 0, 0], up=[0, 1, 0]).scale(0.7),
    "emitter": {"type": "area", "radiance": 6.0},
}


def floor_scene(
    lights: dict[str, Any] | None = None,
    sensor: dict[str, Any] | None = None,
    size: int = 64,
    integrator: str | dict[str, Any] = "path",
    sampler: str | dict[str, Any] = "independent",
) -> dict[str, Any]:
    """The floor under `lights` (entries of the scene; default: a lamp), seen by `sensor` (default: a pinhole camera).

    `sensor`'s film, sampler and, unless given, `to_world` are filled in: box filter, `size` x `size` pixels.
    """
    sensor = dict(sensor or {"type": "perspective", "fov": 35})
    if sensor["type"] not in ("irradiancemeter", "batch"):
        sensor.setdefault("to_world", T().look_at(origin=[1, 2.5, 5.5], target=[0, 0, 0], up=[0, 1, 0]))
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    sensor.setdefault("film", film)
    sensor["sampler"] = {"type": sampler} if isinstance(sampler, str) else sampler
    integrator = {"type": integrator, "max_depth": 6} if isinstance(integrator, str) else integrator
    return {
        "type": "scene",
        "integrator": integrator,
        "sensor": sensor,
        **({"lamp": LAMP} if lights is None else lights),
        "floor": {
            "type": "rectangle",
            "to_world": T().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.4, 0.3]}},
        },
        "ball": {"type": "sphere", "center": [-0.9, -0.2, 0.1], "radius": 0.8, "bsdf": {"type": "diffuse"}},
        "small": {
            "type": "sphere",
            "center": [0.9, -0.5, 0.7],
            "radius": 0.5,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.5, 0.7]}},
        },
    }
