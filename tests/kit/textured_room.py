"""A textured floor under a ball and a lamp."""

from __future__ import annotations

from typing import Any

import numpy as np

from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import TensorXf

__all__ = ["FLOOR", "TURNED", "WALL", "bitmap", "close", "room", "texels"]

TURNED = T().rotate([0, 0, 1], 30).scale([2, 3, 1]).translate([0.1, 0.2, 7])


def texels(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 0.9, shape).astype(np.float32)


def bitmap(data: Any, **keys: Any) -> dict[str, Any]:
    """A bitmap that both renderers accept: Mitsuba needs a tensor."""
    return {"type": "bitmap", "data": TensorXf(data), "raw": True, **keys}


def room(floor: Any, wall: Any = 0.5, integrator: str = "path", **nodes: Any) -> dict[str, Any]:
    """A textured floor under a ball, a lamp above them."""
    camera = T().look_at(origin=[0, -3, 3], target=[0, 0, 0], up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": 4},
        "sensor": {"type": "perspective", "fov": 40, "to_world": camera, "film": film},
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": floor}},
        "ball": {
            "type": "sphere", "radius": 0.5, "center": [0, 0, 0.5],
            "bsdf": {"type": "twosided", "inner": {"type": "diffuse", "reflectance": wall}},
        },
        "lamp": {
            "type": "rectangle", "to_world": T().translate([0, 0, 4]).rotate([1, 0, 0], 180),
            "emitter": {"type": "area", "radiance": 4.0},
        },
        **nodes,
    }  # fmt: skip


def close(image: np.ndarray, reference: np.ndarray) -> float:
    """The share of pixels that agree."""
    return float(np.mean(np.abs(image - reference).max(axis=2) <= 1e-3 * np.maximum(1, reference.max(axis=2))))


FLOOR, WALL = "floor.bsdf.reflectance", "ball.bsdf.brdf_0.reflectance"
