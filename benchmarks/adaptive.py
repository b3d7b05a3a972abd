"""Adaptive renders against renders with equal numbers of samples: error for the same time, and bias.

    python benchmarks/adaptive.py [--size N] [--spp N] [--seeds N] [--bias N]

For each scene and filter: the relative RMSE and the processor time of both, means over the seeds, and the ratio of the
errors at equal time, as errors go down with the root of the time. `--bias N` takes the mean image of N adaptive renders
and tells its largest difference from the reference over tiles of 8 x 8 pixels, in standard errors.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import time
from typing import Any

import drjit as dr
import numpy as np

T = djpt.ScalarTransform4f

RED_GREEN_BLUE = np.array([0.212671, 0.715160, 0.072169])


def hard_corner() -> dict[str, Any]:
    """A glowing floor, which has no noise, and in one corner a lamp behind bars, whose shadows have much."""
    grey = {"type": "diffuse", "reflectance": 0.6}
    bars = {
        f"bar{i}": {
            "type": "cube",
            "to_world": T()
            .translate([2.6, 0, -2.6])
            .rotate([0, 1, 0], 30 * i)
            .translate([0.55, 0.5, 0])
            .scale([0.05, 0.5, 0.09]),
            "bsdf": grey,
        }
        for i in range(12)
    }
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "fov": 42,
            "to_world": T().look_at(origin=[0, 9, 6], target=[0, 0, -0.4], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 128, "height": 128, "rfilter": {"type": "gaussian"}},
            "sampler": {"type": "independent"},
        },
        "floor": {
            "type": "rectangle",
            "to_world": T().rotate([1, 0, 0], -90).scale(4),
            "bsdf": grey,
            "emitter": {"type": "area", "radiance": 0.3},
        },
        "lamp": {
            "type": "sphere",
            "center": [2.6, 0.5, -2.6],
            "radius": 0.2,
            "emitter": {"type": "area", "radiance": 60.0},
        },
        **bars,
    }


def described(name: str, size: int, rfilter: str) -> djpt.scene.scene.Scene:
    """A scene with a square film."""
    description = hard_corner() if name == "hard corner" else djpt.scenes.SCENES[name]()
    description["sensor"]["film"].update(width=size, height=size, rfilter={"type": rfilter})
    return djpt.load_dict(description)


def rendered(scene: Any, **options: Any) -> tuple[Any, float]:
    """The last accumulation of a render in rounds, and the processor time."""
    start = time.process_time()
    *_, found = djpt.render_passes(scene, **options)
    found.image()
    dr.sync_thread()
    return found, time.process_time() - start


def luminance(found: Any) -> np.ndarray:
    """The luminance of an image, float64."""
    return found.image().numpy()[..., :3].astype(np.float64) @ RED_GREEN_BLUE


def largest_bias(scene: Any, reference: Any, count: int, options: dict[str, Any]) -> float:
    """The largest difference of a tile's mean over many renders from the reference, in standard errors."""

    def tiles(image: np.ndarray) -> np.ndarray:
        rows, columns = (n // 8 for n in image.shape)
        return image[: 8 * rows, : 8 * columns].reshape(rows, 8, columns, 8).mean((1, 3))

    found = np.stack([tiles(luminance(rendered(scene, seed=seed, **options)[0])) for seed in range(count)])
    of_reference = tiles(reference.error().pixels.numpy().astype(np.float64) ** 2) / 64
    error = np.sqrt(found.var(0, ddof=1) / count + of_reference)
    return float((np.abs(found.mean(0) - tiles(luminance(reference))) / np.maximum(error, 1e-7)).max())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--spp", type=int, default=256)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--reference", type=int, default=16384)
    parser.add_argument("--bias", type=int, default=0)
    parser.add_argument("--scenes", nargs="*", default=["hard corner", "cornell_box", "shader_ball"])
    options = parser.parse_args()
    print("| scene | filter | equal counts | adaptive | gain at equal time | bias |")
    print("|---|---|---|---|---|---|")
    for name in options.scenes:
        for rfilter in ("box", "gaussian"):
            scene = described(name, options.size, rfilter)
            reference, _ = rendered(scene, spp=options.reference, seed=2**31, round_spp=256)
            truth, cells, scores = luminance(reference), [], []
            for adaptive in (False, True):
                how = {"spp": options.spp, "round_spp": max(1, options.spp // 16), "adaptive": adaptive}
                rendered(scene, **how)
                runs = [rendered(scene, seed=seed, **how) for seed in range(1, options.seeds + 1)]
                squares = [float(np.mean((luminance(found) - truth) ** 2)) for found, _ in runs]
                error = float(np.sqrt(np.mean(squares))) / truth.mean()
                seconds = float(np.median([seconds for _, seconds in runs]))
                cells.append(f"{error:.2%} in {seconds:.2f} s")
                scores.append(error * seconds**0.5)
            bias = "" if not options.bias else f"{largest_bias(scene, reference, options.bias, how):.1f}"
            print(f"| {name} | {rfilter} | {' | '.join(cells)} | {scores[0] / scores[1]:.2f} | {bias} |", flush=True)


if __name__ == "__main__":
    main()
