"""Scenes whose light is hard to find from the camera: classic tests of methods that start at the lights as well."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f as T
from djpt.scenes.cornell import cornell_box, shape

__all__ = [
    "door_ajar",
    "fixture",
    "glass_ball",
    "lamp_behind_pane",
    "lamp_in_glass",
    "parabolic_mirror",
    "pool",
    "sky",
    "stage",
]

RADIANCE = (18.387, 13.9873, 6.75357)
"""The radiance of the Cornell box's lamp."""


def fixture() -> dict[str, Any]:
    """The Cornell box lit by a small lamp in a box that is open at the top: all light comes from the ceiling.

    Light samples hit the box. 128x128 pixels, `bdpt` with 8 edges.
    """
    scene = room()
    scene["light"]["to_world"] = T().translate([0, 0.6, 0.01]).rotate([1, 0, 0], -90).scale([0.08, 0.08, 1])
    scene["light"]["emitter"] = lamp(8.0)
    scene["bottom"] = block([-0.12, 0.55, -0.11], [0.12, 0.58, 0.13])
    scene["left"] = block([-0.12, 0.58, -0.11], [-0.10, 0.75, 0.13])
    scene["right"] = block([0.10, 0.58, -0.11], [0.12, 0.75, 0.13])
    scene["back-side"] = block([-0.10, 0.58, -0.11], [0.10, 0.75, -0.09])
    scene["front-side"] = block([-0.10, 0.58, 0.11], [0.10, 0.75, 0.13])
    return scene


def glass_ball() -> dict[str, Any]:
    """The Cornell box with a small lamp and a glass ball: a caustic on the floor.

    128x128 pixels, `bdpt` with 8 edges.
    """
    scene = room()
    del scene["small-box"]
    scene["ball"] = {"type": "sphere", "center": [0.4, -0.55, 0.35], "radius": 0.3, "bsdf": {"type": "dielectric"}}
    scene["light"]["to_world"] = T().translate([0, 0.99, 0.01]).rotate([1, 0, 0], 90).scale([0.0575, 0.0475, 0.19])
    scene["light"]["emitter"] = lamp(16.0)
    return scene


def lamp_in_glass() -> dict[str, Any]:
    """The Cornell box lit by a small lamp inside a glass ball: all light is a caustic.

    128x128 pixels, `bdpt` with 8 edges.
    """
    scene = room()
    del scene["small-box"], scene["light"]
    centre = [0.0, 0.55, 0.0]
    scene["ball"] = {"type": "sphere", "center": centre, "radius": 0.2, "bsdf": {"type": "dielectric"}}
    radiance = {"type": "rgb", "value": [60.0, 45.0, 25.0]}
    scene["lamp"] = {
        "type": "sphere",
        "center": centre,
        "radius": 0.05,
        "emitter": {"type": "area", "radiance": radiance},
    }
    return scene


def lamp_behind_pane() -> dict[str, Any]:
    """`lamp_in_glass` seen through a pane of glass: all light is refracted, scattered and refracted again.

    Nothing that is seen can be connected to a vertex of a light path. 128x128 pixels, `sppm` with 10 edges.
    """
    scene = lamp_in_glass()
    scene["integrator"] = {"type": "sppm", "max_depth": 10}
    pane = T().translate([0, 0, 1.4]).scale([1.5, 1.5, 0.03])
    scene["pane"] = {"type": "cube", "to_world": pane, "bsdf": {"type": "dielectric"}}
    return scene


def door_ajar() -> dict[str, Any]:
    """Two rooms and one lamp in the hidden room: light comes through the narrow gap of a door ajar.

    Paths from either side seldom find it. 128x128 pixels, `bdpt` with 8 edges.
    """
    scene = room()
    del scene["green-wall"]
    scene["light"]["to_world"] = T().translate([2.0, 0.99, 0.01]).rotate([1, 0, 0], 90).scale([0.23, 0.19, 0.19])
    scene["light"]["emitter"] = lamp(20.0)
    scene["wall"] = block([1.0, -1, -1], [1.05, 1, -0.03])
    scene["door"] = block([1.0, -1, 0.03], [1.05, 1, 1])
    scene["lintel"] = block([1.0, 0.6, -0.03], [1.05, 1, 0.03])
    scene["floor-2"] = shape("rectangle", T().translate([2, -1, 0]).rotate([1, 0, 0], -90), "white")
    scene["ceiling-2"] = shape("rectangle", T().translate([2, 1, 0]).rotate([1, 0, 0], 90), "white")
    scene["back-2"] = shape("rectangle", T().translate([2, 0, -1]), "white")
    scene["front-2"] = shape("rectangle", T().translate([2, 0, 1]).rotate([0, 1, 0], 180), "white")
    scene["right-2"] = shape("rectangle", T().translate([3, 0, 0]).rotate([0, 1, 0], -90), "green")
    return scene


def parabolic_mirror() -> dict[str, Any]:
    """A point light at the focus of a parabolic mirror, facing a white screen: a caustic known in closed form.

    With the focal length f, 0.5, the reflectance a of the mirror, 0.9, the distance D of focus and screen, 2.5, and the
    intensity I, 1, the screen sends out at the distance r from the axis::

        I / pi (a / f^2 / (1 + r^2 / (4 f^2))^2 + D / (D^2 + r^2)^(3/2)),    the first term for r < 1 only,

    if paths have at most three edges. Nothing that starts at the camera alone finds the first. The camera stands on the
    axis, 2 before the screen, of which it sees [-1.5, 1.5]^2. 64x64 pixels, box filter, `bdpt` with 3 edges.
    """
    return {
        "type": "scene",
        "integrator": {"type": "bdpt", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(0.75)),
            "to_world": T().look_at(origin=[0, 0, 1], target=[0, 0, 3], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 64},
        },
        "lamp": {"type": "point", "position": [0, 0, 0.5], "intensity": 1.0},
        "mirror": {
            "type": "paraboloid",
            "focal_length": 0.5,
            "length": 0.5,
            "flip_normals": True,
            "bsdf": {"type": "mirror", "reflectance": 0.9},
        },
        "screen": {
            "type": "rectangle",
            "to_world": T().translate([0, 0, 3]).rotate([0, 1, 0], 180).scale(2),
            "bsdf": {"type": "diffuse", "reflectance": 1.0},
        },
    }


def pool() -> dict[str, Any]:
    """A tiled pool under a small lamp: the floor is lit and seen through waves.

    Each path from the camera to the lamp has a diffuse vertex between two refractions. 128x128 pixels, `sppm` with 8
    edges.
    """
    blue, white = ({"type": "rgb", "value": value} for value in ([0.15, 0.4, 0.5], [0.7, 0.75, 0.75]))
    tiles = {"type": "checkerboard", "color0": blue, "color1": white, "to_uv": T().scale(4)}
    plaster = {"type": "diffuse", "reflectance": 0.7}
    sides = {
        "back": T().translate([0, 0, -1]),
        "front": T().translate([0, 0, 1]).rotate([0, 1, 0], 180),
        "left": T().translate([-1, 0, 0]).rotate([0, 1, 0], 90),
        "right": T().translate([1, 0, 0]).rotate([0, 1, 0], -90),
    }
    # The sides end just above the waves.
    upright = T().translate([0, -0.65, 0]).scale([1, 0.35, 1])
    return {
        "type": "scene",
        "integrator": {"type": "sppm", "max_depth": 8},
        "sensor": {
            "type": "perspective",
            "fov": 35,
            "to_world": T().look_at(origin=[0, 2.6, 1.9], target=[0, -0.7, -0.1], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 128, "height": 128, "rfilter": {"type": "gaussian"}},
            "sampler": {"type": "independent", "sample_count": 256},
        },
        "lamp": {
            "type": "rectangle",
            "to_world": T().translate([-0.5, 2, -0.6]).rotate([1, 0, 0], 90).scale(0.05),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [2200.0, 2000.0, 1700.0]}},
        },
        "floor": {
            "type": "rectangle",
            "to_world": T().translate([0, -1, 0]).rotate([1, 0, 0], -90),
            "bsdf": {"type": "diffuse", "reflectance": tiles},
        },
        **{name: {"type": "rectangle", "to_world": place @ upright, "bsdf": plaster} for name, place in sides.items()},
        "water": waves(),
    }


def waves(steps: int = 96) -> Any:
    """The surface of the water of `pool`, of 2 steps^2 triangles with smooth normals: a sum of waves."""
    from djpt.shapes.mesh import Mesh  # the other scenes need no meshes

    z, x = np.mgrid[-1 : 1 : (steps + 1) * 1j, -1 : 1 : (steps + 1) * 1j]
    kinds = ((11.0, 5.0, 0.3, 0.008), (-7.0, 15.0, 1.1, 0.006), (17.0, 13.0, 2.3, 0.003), (-20.0, 9.0, 0.7, 0.002))
    height = sum(size * np.sin(a * x + b * z + phase) for a, b, phase, size in kinds)
    points = np.stack([x, height - 0.4, z], -1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)).ravel()
    near, right, far = corner + steps + 1, corner + 1, corner + steps + 2
    faces = np.concatenate([np.stack([corner, near, right], 1), np.stack([right, near, far], 1)])
    found = Mesh("water", points, faces, props={"bsdf": {"type": "dielectric", "int_ior": "water"}})
    found.recompute_vertex_normals()
    return found


def room() -> dict[str, Any]:
    """The Cornell box with a smaller film, for `bdpt`."""
    scene = cornell_box()
    scene["integrator"] = {"type": "bdpt", "max_depth": 8}
    scene["sensor"]["film"].update(width=128, height=128)
    return scene


def lamp(factor: float) -> dict[str, Any]:
    """The light of the Cornell box, made brighter by a factor."""
    return {"type": "area", "radiance": {"type": "rgb", "value": [factor * x for x in RADIANCE]}}


def block(low: Sequence[float], high: Sequence[float]) -> dict[str, Any]:
    """A white box between two corners."""
    middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    half = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
    return shape("cube", T().translate(middle).scale(half), "white")


# ---- a stage for lights and cameras, and a sky for it ----------------------------------------


def stage(lights: dict[str, Any] | None = None, size: int = 256) -> dict[str, Any]:
    """A ball, a block and a post on a floor in front of a wall; z is up.

    `lights` are further entries of the scene (default: an area light above); the picture has `size` x `size`
    pixels, 256 samples each, and paths have up to 6 edges.
    """
    if lights is None:
        lights = {"lamp": {"type": "rectangle", "to_world": above(), "emitter": {"type": "area", "radiance": 30.0}}}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sensor": {
            "type": "perspective",
            "fov": 30,
            "to_world": T().look_at(origin=[0.6, -7.5, 2.6], target=[0, 0, 0.85], up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "gaussian"}},
            "sampler": {"type": "independent", "sample_count": 256},
        },
        **lights,
        "floor": {"type": "rectangle", "to_world": T().scale(12), "bsdf": paint(0.55, 0.53, 0.5)},
        "wall": {
            "type": "rectangle",
            "to_world": T().translate([0, 2.2, 0]).rotate([1, 0, 0], 90).scale(12),
            "bsdf": paint(0.6, 0.6, 0.6),
        },
        "ball": {"type": "sphere", "center": [-1.0, -0.3, 0.7], "radius": 0.7, "bsdf": paint(0.62, 0.25, 0.16)},
        "block": {
            "type": "cube",
            "to_world": T().translate([0.75, 0.5, 0.8]).rotate([0, 0, 1], 28).scale([0.45, 0.45, 0.8]),
            "bsdf": paint(0.2, 0.4, 0.45),
        },
        "post": {"type": "cylinder", "p0": [0.45, -1.1, 0], "p1": [0.45, -1.1, 0.6], "radius": 0.16, "bsdf": both()},
    }


def above() -> T:
    """The transform of the default lamp."""
    return T().look_at(origin=[-2.2, -2.2, 4.2], target=[0, 0, 0.5], up=[0, 0, 1]).scale(0.7)


def paint(*value: float) -> dict[str, Any]:
    """A diffuse colour."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(value)}}


def both() -> dict[str, Any]:
    """A diffuse material on both sides, for the open cylinder."""
    return {"type": "twosided", "inner": paint(0.75, 0.6, 0.2)}


def sky(height: int = 128, sun: float = 4000.0, elevation: float = 35.0, azimuth: float = 60.0) -> NDArray[np.float32]:
    """A clear day as an environment map, (height, 2 height, 3), linear: y up, as in an `envmap` that isn't turned.

    The sky is blue and brighter towards the horizon, the ground is grey. The sun, of radiance `sun`, stands
    `elevation` degrees above the horizon, `azimuth` degrees from the middle of the picture, with a radius of
    2.5 degrees or one texel: larger than the real one, so that small maps show it.
    """
    width = 2 * height
    row, column = np.mgrid[0:height, 0:width] + 0.5
    theta, phi = np.pi * row / height, 2 * np.pi * column / width
    up = np.cos(theta)
    horizon = np.exp(-5 * np.abs(up))[..., None]
    blue, pale, ground = np.array([0.16, 0.36, 0.9]), np.array([0.75, 0.85, 1.0]), np.array([0.16, 0.15, 0.13])
    image = np.where(up[..., None] > 0, blue + horizon * (pale - blue), ground * (1 - 0.3 * horizon))
    place = np.pi / 2 - np.radians(elevation), np.pi + np.radians(azimuth)
    cosine = np.cos(theta) * np.cos(place[0]) + np.sin(theta) * np.sin(place[0]) * np.cos(phi - place[1])
    image[cosine > np.cos(max(np.radians(2.5), np.pi / height))] = sun * np.array([1.0, 0.88, 0.7])
    return image.astype(np.float32)
