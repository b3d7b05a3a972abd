"""What moves while the shutter is open."""

from __future__ import annotations

from typing import Any

import numpy as np

import djpt
from djpt import AnimatedTransform4f as A
from djpt import ScalarTransform4f as T
from places import IMAGES

__all__ = ["motion"]

WIDTH, HEIGHT = 320, 240


def paint(*color: float) -> dict[str, Any]:
    """A diffuse surface."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(color)}}


def stage(sensor: dict[str, Any], **parts: Any) -> np.ndarray:
    """A picture of some shapes on a floor, in the light of a lamp and a pale sky."""
    place = T().look_at(origin=[0, 1.1, 6], target=[0, 0.75, 0], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT}
    lamp = T().translate([-3, 5, 3]).look_at([0, 0, 0], [3, -4.5, -3], [0, 1, 0]).scale(1.2)
    ground = {"type": "checkerboard", "color0": 0.25, "color1": 0.5, "to_uv": T().scale([24, 24, 1])}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 5},
        "sensor": {"type": "perspective", "fov": 38, "to_world": place, "film": film, **sensor},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.25, 0.3, 0.38]}},
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": 11.0}},
        "floor": {
            "type": "rectangle",
            "to_world": T().rotate([1, 0, 0], -90).scale(12),
            "bsdf": {"type": "diffuse", "reflectance": ground},
        },
        **parts,
    }
    return np.array(djpt.render(djpt.load_dict(scene), spp=1024))


def wheel() -> np.ndarray:
    """A wheel with five spokes, one of them painted, turns by 25 degrees."""
    spokes = {
        f"spoke{k}": {
            "type": "cube",
            "to_world": T().rotate([0, 0, 1], 72 * k).translate([0, 0.45, 0]).scale([0.05, 0.42, 0.05]),
            "bsdf": paint(0.85, 0.15, 0.08) if k == 0 else paint(0.7, 0.7, 0.7),
        }
        for k in range(5)
    }
    rim = {"type": "torus", "major": 0.88, "minor": 0.1, "bsdf": paint(0.1, 0.12, 0.15)}
    hub = {"type": "sphere", "radius": 0.16, "bsdf": {"type": "roughconductor", "material": "Al", "alpha": 0.2}}
    axle = T().translate([0, 1, 0]).rotate([0, 1, 0], 25)
    turns = A({0: axle, 1: axle.rotate([0, 0, 1], -25)})
    group = {"type": "shapegroup", "rim": rim, "hub": hub, **spokes}
    shown = {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": turns}
    return stage({"shutter_close": 1.0}, group=group, wheel=shown)


def passing() -> np.ndarray:
    """A box on its way to the right, between two posts that stand still; its lamp goes with it."""
    way = A({0: T().translate([-0.6, 0, 0]), 1: T().translate([0.4, 0, 0])})
    body = {"type": "cuboid", "min": [-0.7, 0.15, -0.4], "max": [0.7, 0.75, 0.4], "bsdf": paint(0.1, 0.3, 0.75)}
    lamp = {"type": "sphere", "center": [0.72, 0.35, 0.3], "radius": 0.06}
    yellow = paint(0.8, 0.7, 0.2)
    posts = {
        f"post{k}": {"type": "cylinder", "p0": [x, 0, z], "p1": [x, 1.7, z], "radius": 0.05, "bsdf": yellow}
        for k, (x, z) in enumerate(((-0.9, 0.9), (1.2, -0.9)))
    }
    light = {"type": "area", "radiance": {"type": "rgb", "value": [60, 45, 20]}}
    lit = {**lamp, "emitter": light, "to_world": way}
    return stage({"shutter_close": 1.0}, body={**body, "to_world": way}, front=lit, **posts)


def falling() -> np.ndarray:
    """A ball that falls, as a rolling shutter sees it, which reads the rows of the picture one after the other."""
    keys = {t: T().translate([-0.7, 1.75 - 1.0 * t - 2.2 * t * t, 0]) for t in np.linspace(0, 0.8, 9).tolist()}
    ball = {"type": "sphere", "radius": 0.33, "bsdf": paint(0.9, 0.5, 0.1)}
    still = {"type": "sphere", "center": [0.9, 0.33, 0], "radius": 0.33, "bsdf": paint(0.9, 0.5, 0.1)}
    return stage({"rolling_shutter": 0.6, "shutter_close": 0.01}, ball={**ball, "to_world": A(keys)}, still=still)


def motion() -> None:
    """A wheel that spins, a box that passes, and a ball that falls before a rolling shutter."""
    gap = np.ones((HEIGHT, 8, 3), np.float32)
    pictures = [wheel(), gap, passing(), gap, falling()]
    djpt.write(IMAGES / "motion.png", np.concatenate(pictures, axis=1))
