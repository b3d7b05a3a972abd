"""Images compared with radiance that is known by formula.

An image passes if Welch's test of its mean, and then that of all pixels, finds nothing but noise (false alarms: 1e-4
each), or if it is right to 1e-4 of the radiance.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.validation.closed_forms.cases import ALBEDO, camera
from djpt.validation.statistics import Batches, mean_test, pixel_test

__all__ = [
    "BY_CHANCE",
    "BY_LIGHT_SAMPLES",
    "FROM_LIGHTS",
    "Array",
    "Keys",
    "check",
    "on_the_floor",
    "render",
]


def plane(**more: Any) -> dict[str, Any]:
    """A large diffuse floor z = 0 that faces up."""
    bsdf = {"type": "diffuse", "reflectance": ALBEDO}
    return {"type": "rectangle", "to_world": T().scale(1000.0), "bsdf": bsdf, **more}


def on_the_floor(spot: Any = (0, 0, 0), depth: int = 2, **lights: Any) -> dict[str, Any]:
    """A camera that looks at `spot` of the floor from the side, under some lights."""
    x, y, _ = spot
    sensor = camera(spot, (x + 3, y + 3, 2.0), up=(0, 0, 1))
    integrator = {"type": "path", "max_depth": depth}
    return {"type": "scene", "integrator": integrator, "sensor": sensor, "floor": plane(), **lights}


Array = np.ndarray


Keys = dict[str, Any]
BATCHES = 16
UNIFORM, COSINE = {"type": "path_naive", "hemisphere": "uniform"}, {"type": "path_naive", "hemisphere": "cosine"}
# Russian roulette only in `path_nee`, which has its own parameter for it.
BY_CHANCE: list[Keys] = [{**UNIFORM, "rr_depth": 99}, {**COSINE, "rr_depth": 99}, {"type": "prb_basic"}]
BY_LIGHT_SAMPLES: list[Keys] = [
    {"type": "path_nee"},
    {"type": "path_nee", "russian_roulette": 1.0},
    {"type": "path", "rr_depth": 99},
    {"type": "prb", "rr_depth": 99},
    {"type": "distributed", "split": 1, "light_samples": 2},
]


FROM_LIGHTS: list[Keys] = [{"type": "ptracer", "rr_depth": 99}, {"type": "bdpt", "rr_depth": 99}]


def render(scene: Keys, integrator: Keys, depth: int, spp: int) -> Batches:
    """Independent images, `spp` samples per pixel in all."""
    loaded, limit = djpt.load_dict(scene), {} if integrator["type"] == "direct" else {"max_depth": depth}
    plugin, result = djpt.load_dict({**integrator, **limit}), Batches()
    for k in range(BATCHES):
        result.add(np.array(djpt.render(loaded, integrator=plugin, spp=max(1, spp // BATCHES), seed=11 + k)))
    return result


def check(images: Batches, expected: Array | float, exact: float = 1e-4) -> None:
    """Assert that the mean is `expected` (per pixel and channel, or for all), up to noise or `exact` of the largest."""
    known = Batches()
    for _ in range(2):
        known.add(np.broadcast_to(expected, images.shape))
    difference = images.mean - known.mean
    for test, error in ((mean_test, difference.mean(axis=(0, 1))), (pixel_test, difference)):
        result = test(images, known, 1e-4, equal_variance=False)
        assert result.passed or np.abs(error).max() <= exact * known.mean.max(), f"{result}, off by {error.mean()}"
