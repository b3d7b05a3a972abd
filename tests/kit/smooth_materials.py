"""Smooth metals and glass, asked without a scene."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, SurfaceInteraction3f, TransportMode
from djpt.jit.types import Float, Point2f, Vector3f

__all__ = [
    "ANGLES",
    "CASES",
    "COUNT",
    "GOLD",
    "TINTED",
    "directions",
    "from_angles",
    "interaction",
    "mitsuba",
    "sampled",
    "weights",
    "wide",
]

COUNT = 4096
GOLD = {"eta": {"type": "rgb", "value": [0.143, 0.375, 1.442]}, "k": {"type": "rgb", "value": [3.983, 2.386, 1.603]}}
TINTED = {
    "specular_reflectance": {"type": "rgb", "value": [0.9, 0.5, 0.2]},
    "specular_transmittance": {"type": "rgb", "value": [0.3, 0.6, 0.8]},
}


CASES: dict[str, dict[str, Any]] = {
    "conductor": {"type": "conductor"},
    "gold": {"type": "conductor", "material": "Au"},
    "index": {"type": "conductor", **GOLD, "specular_reflectance": TINTED["specular_reflectance"]},
    "eta alone": {"type": "conductor", "eta": 1.5},
    "k alone": {"type": "conductor", "k": 2.5},
    "dielectric": {"type": "dielectric"},
    "tinted": {"type": "dielectric", "int_ior": 1.8, "ext_ior": "water", **TINTED},
    "bubble": {"type": "dielectric", "int_ior": "air", "ext_ior": "Diamond"},
    "equal": {"type": "dielectric", "int_ior": 1.3, "ext_ior": 1.3},
    "thin": {"type": "thindielectric"},
    "thin, tinted": {"type": "thindielectric", "int_ior": "pet", "ext_ior": 1.0, **TINTED},
    "thin bubble": {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.5},
    "null": {"type": "null"},
}


def mitsuba() -> Any:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    return mi


def interaction(wi: Any) -> SurfaceInteraction3f:
    """A surface point in its own frame, seen from `wi`, (3, N)."""
    z, wi = Vector3f(0, 0, 1), Vector3f(wi)
    frame = Frame3f(Vector3f(1, 0, 0), Vector3f(0, 1, 0), z)
    t = dr.full(Float, 1, dr.width(wi))
    return SurfaceInteraction3f(t=t, n=z, sh_frame=frame, uv=Point2f(0.3, 0.6), dp_du=frame.s, dp_dv=frame.t, wi=wi)


def from_angles(*degrees: float) -> np.ndarray:
    """Directions in the plane y = 0 at angles to the normal, (3, N)."""
    angles = np.radians(degrees)
    return np.stack([np.sin(angles), 0 * angles, np.cos(angles)])


def directions(seed: int = 0) -> np.ndarray:
    """Unit vectors from all sides, (3, COUNT)."""
    w = np.random.default_rng(seed).normal(size=(3, COUNT))
    return w / np.linalg.norm(w, axis=0)


def wide(value: Any, width: int) -> np.ndarray:
    """The components (or one number) per lane as float64; uniform ones are repeated."""
    array = np.array(value, np.float64)
    return np.broadcast_to(array, (*array.shape[:-1], width)) if array.ndim else np.full(width, array)


def sampled(bsdf: Any, wi: Any, sample1: Any, mode: TransportMode = TransportMode.Radiance) -> dict[str, np.ndarray]:
    width = np.asarray(wi).shape[1]
    s1 = Float(np.broadcast_to(sample1, width).copy())
    bs, weight = bsdf.sample(BSDFContext(mode), interaction(wi), s1, Point2f(0.5, 0.5))
    found = {"wo": bs.wo, "pdf": bs.pdf, "eta": bs.eta, "type": bs.sampled_type, "weight": weight}
    found["component"] = bs.sampled_component
    return {name: wide(value, width) for name, value in found.items()}


ANGLES = from_angles(0, 20, 50, 70, 85, 89)


def weights(description: dict[str, Any], wi: np.ndarray = ANGLES) -> np.ndarray:
    return sampled(djpt.load_dict(description), wi, 0.5)["weight"]
