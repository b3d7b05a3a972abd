"""The scenes of benchmarks of lights: twenty spheres under a sky with a sun."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["sky", "spheres_under_sky"]


def sky(width: int = 512, height: int = 256) -> np.ndarray:
    """A blue sky over brown ground, with clouds and a sun a few texels wide: (height, width, 3) float32."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    up = np.cos(np.pi * v)[..., None]
    clouds = 0.5 + 0.5 * np.sin(2 * np.pi * (5 * u + np.sin(9 * v)))[..., None]
    image = np.where(up > 0, [0.3, 0.5, 0.9] + 0.4 * clouds * (1 - up), [0.25, 0.2, 0.15])
    sun = np.exp(-((u - 0.35) ** 2 + (0.5 * (v - 0.2)) ** 2) / (2 * 0.004**2))[..., None]
    return (image + sun * [900, 800, 600]).astype(np.float32)


def spheres_under_sky(module: Any, ground: bool, size: int = 256) -> dict[str, Any]:
    """Twenty diffuse spheres, with `ground` above a floor, as the `module` djpt or mitsuba describes them."""
    T = module.ScalarTransform4f
    random = np.random.default_rng(0)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": T().look_at(origin=[0, 5, 11], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent"},
        },
        "sky": {"type": "envmap", "bitmap": module.Bitmap(sky()) if hasattr(module, "Bitmap") else sky()},
    }
    for i in range(20):
        x, y = divmod(i, 5)
        scene[f"ball {i}"] = {
            "type": "sphere",
            "center": [1.5 * (y - 2), 0.0, 1.5 * (x - 1.5)],
            "radius": float(random.uniform(0.4, 0.7)),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": random.uniform(0.1, 0.9, 3).tolist()}},
        }
    if ground:
        scene["ground"] = {
            "type": "rectangle",
            "to_world": T().translate([0, -0.7, 0]).rotate([1, 0, 0], -90).scale(8),
            "bsdf": {"type": "diffuse", "reflectance": 0.4},
        }
    return scene
