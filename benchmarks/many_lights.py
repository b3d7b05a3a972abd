"""The error at equal time in scenes of 1000 lights, by the way in which emitters are chosen.

    python benchmarks/many_lights.py [--lights N] [--size N] [--rounds N] [--quick]

Each choice renders as many samples as it can in the same time: the errors (root of the mean square
against a long reference by the tree) are brought to equal time by error * sqrt(time), since the
variance falls with the samples. Rounds are interleaved; medians.

Camera rays pass through the lamps (`hide_emitters`): the noise at the edges of visible lamps is the same for
all choices and larger than all other noise, so with it the tree's ratio would be below 1. The constants of
`djpt.emitters.light_samplers.tree_build` were chosen for the floors of these scenes.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.transforms import ScalarTransform4f as T
from djpt.emitters.light_samplers import LIGHT_SAMPLERS

__all__ = ["SCENES", "area_lights", "point_lights"]

EXTENT = 20.0
"""Half the side of the floor."""

SPP = {"uniform": 64, "power": 64, "tree": 64}
REFERENCE_SPP = 8192
REQUIRED = 3.0
"""The factor by which the tree's error must be smaller than that of the uniform choice."""


def hall(size: int) -> dict[str, Any]:
    """A large floor with pillars and a few walls."""
    rng = np.random.default_rng(1)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "fov": 50,
            "to_world": T().look_at(origin=[0, -24, 9], target=[0, -4, 0], up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        },
        "grey": {"type": "diffuse", "reflectance": 0.5},
        "floor": {"type": "rectangle", "to_world": T().scale(EXTENT), "bsdf": {"type": "ref", "id": "grey"}},
    }
    for k in range(24):
        x, y = rng.uniform(-EXTENT, EXTENT, 2)
        half = [*rng.uniform(0.3, 1.2, 2), rng.uniform(0.5, 1.5)]
        place = T().translate([x, y, half[2]]).rotate([0, 0, 1], rng.uniform(0, 90)).scale(half)
        scene[f"block{k}"] = {"type": "cube", "to_world": place, "bsdf": {"type": "ref", "id": "grey"}}
    return scene


def places(rng: np.random.Generator, count: int) -> np.ndarray:
    """The positions of the lights, (count, 3)."""
    return np.stack([*rng.uniform(-EXTENT, EXTENT, (2, count)), rng.uniform(0.8, 3.5, count)], axis=1)


def colour(rng: np.random.Generator, strength: float) -> dict[str, Any]:
    """A random colour; its strength varies around a mean by a factor of ten and more."""
    return {"type": "rgb", "value": (strength * rng.exponential() * rng.uniform(0.3, 1, 3)).tolist()}


def area_lights(count: int = 1000, size: int = 128) -> dict[str, Any]:
    """The hall with area lights: small rectangles that shine downwards, roughly, and spheres."""
    rng, scene = np.random.default_rng(2), hall(size)
    for k, p in enumerate(places(rng, count)):
        light = {"type": "area", "radiance": colour(rng, 100.0)}
        half = rng.uniform(0.02, 0.08)
        if k % 4:
            target = p + np.array([*rng.normal(0, 0.7, 2), -1])
            at = T().look_at(origin=p.tolist(), target=target.tolist(), up=[0.1, 1, 0]).scale(half)
            scene[f"light{k}"] = {"type": "rectangle", "to_world": at, "emitter": light}
        else:
            scene[f"light{k}"] = {"type": "sphere", "center": p.tolist(), "radius": half, "emitter": light}
    return scene


def point_lights(count: int = 1000, size: int = 128) -> dict[str, Any]:
    """The hall with point lights."""
    rng, scene = np.random.default_rng(3), hall(size)
    for k, p in enumerate(places(rng, count)):
        scene[f"light{k}"] = {"type": "point", "position": p.tolist(), "intensity": colour(rng, 1.0)}
    return scene


SCENES: dict[str, Callable[[int, int], dict[str, Any]]] = {"area lights": area_lights, "point lights": point_lights}


def rendered(scene: Any, choice: str, spp: int, seed: int) -> tuple[np.ndarray, float]:
    """Render an image: its pixels and its time in seconds."""
    integrator = djpt.load_dict({"type": "path", "max_depth": 3, "hide_emitters": True, "emitter_choice": choice})
    dr.sync_thread()
    start = time.perf_counter()
    image = djpt.render(scene, integrator=integrator, spp=spp, seed=seed)
    dr.eval(image)
    dr.sync_thread()
    return np.array(image, np.float64), time.perf_counter() - start


def errors(scene: Any, rounds: int, reference_spp: int) -> dict[str, tuple[float, float, float]]:
    """Measure, by choice: (RMSE brought to one second, RMSE at equal samples, seconds per render)."""
    reference = np.mean([rendered(scene, "tree", reference_spp // 8, 100 + k)[0] for k in range(8)], axis=0)
    found: dict[str, list[tuple[float, float]]] = {choice: [] for choice in LIGHT_SAMPLERS}
    for k in range(rounds + 1):
        for choice in LIGHT_SAMPLERS:
            image, seconds = rendered(scene, choice, SPP[choice], k)
            if k:  # the first compiles
                found[choice].append((float(np.sqrt(np.mean((image - reference) ** 2))), seconds))
    result = {}
    for choice, pairs in found.items():
        error, seconds = (statistics.median(column) for column in zip(*pairs, strict=True))
        result[choice] = (error * seconds**0.5, error, seconds)
    return result


def main() -> int:
    """Print the table; return 0 if the tree is as good as required."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--lights", type=int, default=1000)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="smaller images, fewer samples")
    arguments = parser.parse_args()
    size = 64 if arguments.quick else arguments.size
    good = True
    print(f"{'':14}{'choice':10}{'error':>10}{'seconds':>10}{'at equal time, uniform / this':>34}")
    for name, make in SCENES.items():
        scene = djpt.load_dict(make(arguments.lights, size))
        table = errors(scene, arguments.rounds, REFERENCE_SPP // (4 if arguments.quick else 1))
        for choice, (equal_time, error, seconds) in table.items():
            ratio = table["uniform"][0] / equal_time
            print(f"{name:14}{choice:10}{error:10.5f}{seconds:10.3f}{ratio:34.2f}", flush=True)
        good &= table["uniform"][0] / table["tree"][0] >= REQUIRED
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
