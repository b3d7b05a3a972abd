"""The scenes of `media.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["cloud", "fog", "fog_in_meshes", "smoke"]

NULL = {"type": "null"}
OCTAVES = 4
GREY, COLOURED = 0.5, {"type": "rgb", "value": [0.3, 0.5, 0.9]}


def room(module: Any, integrator: str, max_depth: int, size: int) -> dict[str, Any]:
    """The Cornell box; no roulette, so that both renderers have paths of one length."""
    scene: dict[str, Any] = module.cornell_box()
    scene["integrator"] = {"type": integrator, "max_depth": max_depth, "rr_depth": 100}
    scene["sensor"]["film"].update(width=size, height=size, rfilter={"type": "box"})
    return scene


def fog(module: Any, coloured: bool, integrator: str, size: int) -> dict[str, Any]:
    """Fog within the whole room and a little before it."""
    scene = room(module, integrator, 16, size)
    sigma_t: Any = COLOURED if coloured else GREY
    scene["fog"] = {
        "type": "cube",
        "to_world": module.ScalarTransform4f().scale([1.2, 1.2, 1.3]),
        "bsdf": NULL,
        "interior": {"type": "homogeneous", "albedo": 0.9, "sigma_t": sigma_t, "phase": {"type": "hg", "g": 0.5}},
    }
    return scene


def fog_in_meshes(module: Any, file: Path, size: int) -> dict[str, Any]:
    """Bodies of fog whose boundaries are meshes, one of them within another."""
    scene = room(module, "volpath", 16, size)
    for i, (x, radius, sigma_t) in enumerate(((-0.4, 0.4, 2.0), (-0.4, 0.2, 5.0), (0.45, 0.35, 3.0))):
        scene[f"fog-{i}"] = {
            "type": "ply",
            "filename": str(file),
            "to_world": module.ScalarTransform4f().translate([x, 0.2, 0.3]).scale(radius),
            "bsdf": NULL,
            "interior": {"type": "homogeneous", "albedo": 0.9, "sigma_t": sigma_t},
        }
    return scene


def smoke(module: Any, density: NDArray[np.float32], size: int) -> dict[str, Any]:
    """A dense cloud in the middle of the room."""
    scene = room(module, "volpath", 32, size)
    del scene["small-box"], scene["large-box"]
    transform = module.ScalarTransform4f
    scene["smoke"] = {
        "type": "cube",
        "to_world": transform().translate([0, -0.1, 0]).scale(0.71),
        "bsdf": NULL,
        "interior": {
            "type": "heterogeneous",
            "albedo": 0.95,
            "scale": 40.0,
            "sigma_t": {
                "type": "gridvolume",
                "grid": module.VolumeGrid(density[..., None]),
                "to_world": transform().translate([-0.7, -0.8, -0.7]).scale(1.4),
            },
            "phase": {"type": "hg", "g": 0.3},
        },
    }
    return scene


def cloud(resolution: int) -> NDArray[np.float32]:
    """The density of a cloud on a grid (Z, Y, X), the same at any resolution: a ball with ragged edges, at most 1."""
    rng = np.random.default_rng(3)
    axis = (np.arange(resolution) + 0.5) / resolution
    noise = np.zeros((resolution,) * 3, np.float32)
    for octave in range(1, OCTAVES + 1):
        values = rng.random((2 * 2**octave,) * 3).astype(np.float32)
        place = axis * (len(values) - 1.001)
        first = place.astype(int)
        share = (place - first).astype(np.float32)
        for along in range(3):
            shape = [-1 if k == along else 1 for k in range(3)]
            low, high = values.take(first, along), values.take(first + 1, along)
            values = low + (high - low) * share.reshape(shape)
        noise += values / 2**octave
    z, y, x = np.meshgrid(*[2 * axis.astype(np.float32) - 1] * 3, indexing="ij")
    density = np.clip(noise - 0.45 - 0.5 * np.maximum(0, np.sqrt(x * x + y * y + z * z) - 0.35), 0, None)
    return (density / density.max()).astype(np.float32)
