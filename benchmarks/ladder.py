"""The error of each step from ray casting to path tracing, on one scene: the table of docs/theory.

    python benchmarks/ladder.py [--size N] [--spp N] [--seeds N] [--reference N]

Per integrator, over all pixels but those that see the lamp: the light that it shows, as a share of all (mean over
mean of the reference); the root mean square error; the part of it that is noise; and the median of the pixels'
absolute errors, on which a few bright dots have no effect. All values are linear, at equal samples per pixel. The
reference is an image of `path` with `--reference` samples per pixel.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import warnings
from typing import Any

import numpy as np

DEPTH = 8
"""Edges of the longest path, where the algorithm has such a limit."""


def room(size: int = 240) -> dict[str, Any]:
    """The Cornell box with a mirror, a glass and a rough copper ball; box filter, `size` x `size` pixels."""
    scene = djpt.scenes.cornell_box_spheres()
    scene["large-sphere"]["bsdf"] = {"type": "mirror"}
    scene["small-sphere"]["bsdf"] = {"type": "dielectric"}
    copper = {"type": "roughconductor", "material": "Cu", "alpha": 0.05}
    scene["copper"] = {"type": "sphere", "center": [-0.08, -0.8, 0.6], "radius": 0.2, "bsdf": copper}
    scene["sensor"]["film"].update(width=size, height=size, rfilter={"type": "box"})
    return scene


STEPS: dict[str, dict[str, Any]] = {
    "raycast": {"type": "raycast"},
    "whitted": {"type": "whitted"},
    "distributed": {"type": "distributed"},
    "path_naive, uniform": {"type": "path_naive", "hemisphere": "uniform", "max_depth": DEPTH},
    "path_naive, cosine": {"type": "path_naive", "hemisphere": "cosine", "max_depth": DEPTH},
    "path_nee": {"type": "path_nee", "max_depth": DEPTH},
    "direct, light samples": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
    "direct, BSDF samples": {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1},
    "direct, both": {"type": "direct"},
    "path": {"type": "path", "max_depth": DEPTH},
    "ptracer": {"type": "ptracer", "max_depth": DEPTH},
}
"""The integrators by what sets them apart, in the order of the ladder."""


def render(scene: Any, integrator: dict[str, Any], spp: int, seed: int) -> np.ndarray:
    """The image of `scene` by another integrator."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "'Direct' without BSDF samples")
        return np.array(djpt.render(scene, integrator=djpt.load_dict(integrator), spp=spp, seed=seed), np.float64)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--seeds", type=int, default=64)
    parser.add_argument("--reference", type=int, default=32768)
    options = parser.parse_args()

    scene = djpt.load_dict(room(options.size))
    reference = render(scene, STEPS["path"], options.reference, 12345)
    # The edges of the lamp are noisy with every integrator, so its pixels are left out.
    dark = render(scene, {"type": "path", "max_depth": 1}, 256, 0).max(axis=2) == 0
    truth = reference[dark]
    print(f"| {options.spp} spp | light shown | RMSE | noise | median error |\n|---|---|---|---|---|")
    for name, integrator in STEPS.items():
        if name == "raycast":  # what it shows isn't light
            continue
        images = np.array([render(scene, integrator, options.spp, seed)[dark] for seed in range(options.seeds)])
        variance = images.var(axis=0, ddof=1)
        rmse, noise = np.sqrt(np.square(images - truth).mean()), np.sqrt(variance.mean())
        median = np.median(np.abs(images - truth).mean(axis=2))
        print(f"| {name} | {images.mean() / truth.mean():.0%} | {rmse:.3f} | {noise:.3f} | {median:.3f} |", flush=True)


if __name__ == "__main__":
    main()
