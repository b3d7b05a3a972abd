"""A scene for lights and cameras: a few plain objects in front of a wall, and a sky for it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f as T

__all__ = ["sky", "stage"]


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
