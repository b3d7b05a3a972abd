"""Phase functions with different parameters, and points in media that they are asked at."""

from __future__ import annotations

from typing import Any

import numpy as np

import djpt

__all__ = ["FLAKES", "PHASES", "described", "directions", "interaction"]

FLAKES = {
    "sheets": [0.02, 0.4, 0.8, 0.0, 0.0, 0.0],
    "skewed": [0.5, 0.35, 0.32, 0.1, 0.14, 0.2],
}

PHASES: dict[str, dict[str, Any]] = {
    "isotropic": {"type": "isotropic"},
    "forward": {"type": "hg"},
    "backward": {"type": "hg", "g": -0.6},
    "no asymmetry": {"type": "hg", "g": 0.0},
    "hardly any": {"type": "hg", "g": 1e-3},
    "peak": {"type": "hg", "g": 0.95},
    "rayleigh": {"type": "rayleigh"},
    "table": {"type": "tabphase", "values": "0.5, 1.0, 1.5"},
    "gap": {"type": "tabphase", "values": "0.5, 0, 0, 3, 0.2, 0.7, 4"},
    "two numbers": {"type": "tabphase", "values": "0, 1"},
    "blend": {
        "type": "blendphase",
        "weight": 0.3,
        "a": {"type": "hg", "g": 0.5},
        "b": {"type": "rayleigh"},
    },
    "blend of blends": {
        "type": "blendphase",
        "weight": 0.6,
        "a": {"type": "tabphase", "values": "3, 1, 2"},
        "b": {"type": "blendphase", "weight": 0.5, "a": {"type": "isotropic"}, "b": {"type": "hg", "g": -0.3}},
    },
    "one end": {"type": "blendphase", "weight": 1.0, "a": {"type": "hg"}, "b": {"type": "rayleigh"}},
    **{name: {"type": "sggx", "S": numbers} for name, numbers in FLAKES.items()},
}


def described(name: str, module: Any = djpt) -> dict[str, Any]:
    """The description of a phase function, for djpt or for Mitsuba."""
    found = dict(PHASES[name])
    if "S" in found:
        grid = np.array(found["S"], np.float32).reshape(1, 1, 1, 6)
        found["S"] = {"type": "gridvolume", "data": module.TensorXf(grid), "raw": True}
    return found


def directions(count: int, seed: int) -> np.ndarray:
    """Uniform directions, (3, count) float32."""
    found = np.random.default_rng(seed).normal(size=(3, count))
    return (found / np.linalg.norm(found, axis=0)).astype(np.float32)


def interaction(module: Any, wi: Any) -> Any:
    """A point in a medium that light arrives at from `wi`."""
    mei = module.MediumInteraction3f()
    mei.wi = module.Vector3f(wi)
    mei.sh_frame = module.Frame3f(mei.wi)
    mei.p = module.Point3f(0.3, 0.4, 0.5)
    return mei
