"""What moves while the shutter is open."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import djpt
from djpt import AnimatedTransform4f as A
from djpt import ScalarTransform4f as T
from djpt.shapes.meshes.data import MeshData
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
    return np.array(djpt.render(djpt.load_dict(scene), spp=512))


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


def prism(outline: list[tuple[float, float]], depth: float) -> MeshData:
    """A convex outline in x and y, counterclockwise, as a solid from -depth to depth in z."""
    n = len(outline)
    corners = [[x, y, z] for z in (depth, -depth) for x, y in outline]
    front = [[0, i, i + 1] for i in range(1, n - 1)]
    back = [[n, n + i + 1, n + i] for i in range(1, n - 1)]
    sides = [t for i in range(n) for j in [(i + 1) % n] for t in ([i, n + i, j], [j, n + i, n + j])]
    return MeshData(np.array(corners, np.float32), np.array(front + back + sides, np.uint32))


def car(ways: list[float]) -> dict[str, Any]:
    """The parts of a car that drives to the right, by its places at equal times; its wheels roll."""
    times = np.linspace(0, 1, len(ways)).tolist()

    def moving(place: T, roll: bool = False) -> A:
        turns = [T().rotate([0, 0, 1], -math.degrees(x / 0.2) if roll else 0) for x in ways]
        return A({t: T().translate([x, 0, 1.4]) @ place @ turn for t, x, turn in zip(times, ways, turns, strict=True)})

    lower = [(-0.86, 0.2), (0.86, 0.2), (0.86, 0.4), (0.48, 0.48), (-0.72, 0.5), (-0.86, 0.46)]
    upper = [(-0.7, 0.5), (0.48, 0.48), (0.2, 0.74), (-0.44, 0.74)]
    front = [(-0.1, 0.51), (0.36, 0.51), (0.16, 0.69), (-0.1, 0.69)]
    rear = [(-0.58, 0.51), (-0.16, 0.51), (-0.16, 0.69), (-0.4, 0.69)]
    paints = {"lower": (lower, 0.36), "upper": (upper, 0.34), "front": (front, 0.345), "rear": (rear, 0.345)}
    blue = {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.05, 0.2, 0.6]}}
    parts: dict[str, Any] = {
        name: {
            "type": "ply",
            "data": prism(outline, depth),
            "face_normals": True,
            "to_world": moving(T()),
            "bsdf": {"type": "twosided", "bsdf": blue if name in ("lower", "upper") else paint(0.02, 0.02, 0.03)},
        }
        for name, (outline, depth) in paints.items()
    }
    tyre = {"type": "torus", "major": 0.14, "minor": 0.06, "bsdf": paint(0.04, 0.04, 0.04)}
    rim = {"type": "disk", "to_world": T().translate([0, 0, 0.02]).scale(0.12), "bsdf": paint(0.6, 0.6, 0.6)}
    bar = {
        "type": "cube",
        "to_world": T().translate([0, 0, 0.03]).scale([0.11, 0.025, 0.01]),
        "bsdf": paint(0.8, 0.1, 0.05),
    }
    parts["wheel"] = {"type": "shapegroup", "tyre": tyre, "rim": rim, "bar": bar}
    for k, (x, z) in enumerate(((-0.5, 0.33), (0.5, 0.33), (-0.5, -0.33), (0.5, -0.33))):
        place = moving(T().translate([x, 0.2, z]), roll=True)
        parts[f"wheel{k}"] = {"type": "instance", "group": {"type": "ref", "id": "wheel"}, "to_world": place}
    light = {"type": "area", "radiance": {"type": "rgb", "value": [60, 45, 20]}}
    lamp = {"type": "sphere", "center": [0.86, 0.36, 0.27], "radius": 0.035}
    parts["lamp_ahead"] = {**lamp, "emitter": light, "to_world": moving(T())}
    return parts


def passing() -> np.ndarray:
    """A car on its way to the right, between two posts that stand still; its lamp goes with it."""
    yellow = paint(0.8, 0.7, 0.2)
    posts = {
        f"post{k}": {"type": "cylinder", "p0": [x, 0, z], "p1": [x, 1.7, z], "radius": 0.05, "bsdf": yellow}
        for k, (x, z) in enumerate(((-0.75, 2.2), (1.2, -0.9)))
    }
    return stage({"shutter_close": 1.0}, **car([-0.06, 0.0, 0.06]), **posts)


def falling() -> np.ndarray:
    """A ball that falls, as a rolling shutter sees it, which reads the rows of the picture one after the other."""
    keys = {t: T().translate([-0.7, 1.75 - 1.0 * t - 2.2 * t * t, 0]) for t in np.linspace(0, 0.8, 9).tolist()}
    ball = {"type": "sphere", "radius": 0.33, "bsdf": paint(0.9, 0.5, 0.1)}
    still = {"type": "sphere", "center": [0.9, 0.33, 0], "radius": 0.33, "bsdf": paint(0.9, 0.5, 0.1)}
    return stage({"rolling_shutter": 0.6, "shutter_close": 0.01}, ball={**ball, "to_world": A(keys)}, still=still)


def swinging() -> np.ndarray:
    """A room in a fisheye that fills the picture, and a ball that swings below its lamp."""
    place = T().look_at(origin=[0, -0.15, 0.8], target=[0, -0.15, -1], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT}
    sensor = {"type": "fisheye", "projection": "equisolid", "fov": 180, "fov_axis": "diagonal", "shutter_close": 1.0}
    nail = T().translate([0, 0.99, 0])
    swing = A({t: nail @ T().rotate([0, 0, 1], angle) for t, angle in ((0, 9), (0.5, 15), (1, 20))})
    ball = {"type": "sphere", "center": [0, -1.0, 0], "radius": 0.17, "bsdf": paint(0.95, 0.75, 0.15)}
    string = {"type": "cylinder", "p0": [0, 0, 0], "p1": [0, -0.85, 0], "radius": 0.015, "bsdf": paint(0.1, 0.1, 0.1)}
    room = djpt.cornell_box()
    room["sensor"] = {**sensor, "to_world": place, "film": film}
    room |= {"ball": {**ball, "to_world": swing}, "string": {**string, "to_world": swing}}
    return 1.5 * np.array(djpt.render(djpt.load_dict(room), spp=512))


def motion() -> None:
    """A wheel that spins, a car that passes; a ball before a rolling shutter, and a room in a fisheye."""
    gap = np.ones((HEIGHT, 8, 3), np.float32)
    above, below = (np.concatenate([a, gap, b], axis=1) for a, b in ((wheel(), passing()), (falling(), swinging())))
    djpt.write(IMAGES / "motion.png", np.concatenate([above, np.ones((8, above.shape[1], 3), np.float32), below]))
