"""The scenes of `materials.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from mesh_scenes import bumpy_sphere, diffuse, stage

__all__ = ["five_materials", "glass_and_gold", "many_colours"]

GLASS = {"type": "dielectric"}
ROUGH_GOLD = {"type": "roughconductor", "material": "Au", "distribution": "ggx", "alpha": 0.2}


def glass_and_gold(module: Any) -> dict[str, Any]:
    """The Cornell box with a sphere of glass and one of rough gold in place of its boxes."""
    scene = module.cornell_box()
    del scene["small-box"], scene["large-box"]
    scene["integrator"] = {"type": "path", "max_depth": 8}
    scene["sensor"]["film"]["rfilter"] = {"type": "box"}
    scene["glass"] = {"type": "sphere", "center": [0.4, -0.6, 0.3], "radius": 0.4, "bsdf": GLASS}
    scene["gold"] = {"type": "sphere", "center": [-0.4, -0.5, -0.3], "radius": 0.5, "bsdf": ROUGH_GOLD}
    return scene


def five_materials(module: Any, files: list[Path]) -> dict[str, Any]:
    """Twenty bumpy spheres: diffuse, gold, glass, rough gold, plastic."""
    rng = np.random.default_rng(1)
    materials = [
        *(diffuse(rng.uniform(0.2, 0.8, 3)) for _ in range(4)),
        {"type": "conductor", "material": "Au"},
        GLASS,
        ROUGH_GOLD,
        {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.3, 0.6]}},
    ]
    scene = stage(module, [0, 2.5, 7], -0.8, 6, 6)
    for i, file in enumerate(files):
        place = [1.5 * (i % 5 - 2), 0.3 * (i % 3), 1.5 * (i // 5 - 1.5)]
        scene[f"ball_{i}"] = {
            **bumpy_sphere(file, True),
            "to_world": module.ScalarTransform4f().translate(place).scale(0.6),
            "bsdf": materials[i % 8],
        }
    return scene


def many_colours(module: Any) -> dict[str, Any]:
    """200 spheres in a grid, each with a diffuse BSDF of its own."""
    rng = np.random.default_rng(7)
    scene = stage(module, [0, 5, 12], -0.6, 8, 8)
    for i in range(200):
        scene[f"ball_{i}"] = {
            "type": "sphere",
            "center": [0.8 * (i % 20 - 9.5), 0.2 * float(rng.uniform()), 1.1 * (i // 20 - 4.5)],
            "radius": 0.35,
            "bsdf": diffuse(rng.uniform(0.05, 0.9, 3)),
        }
    return scene
