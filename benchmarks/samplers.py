"""The error and time of every sampler, in the Cornell box and on a floor under a white sky.

    python benchmarks/samplers.py [--size N] [--seeds N] [--spp N ..]

For each count, the RMSE divided by that of `independent` at the same requested count, averaged over seeds and over
pixels that see no lamp; `blurred`: the same for images blurred by a Gaussian of 1.5 pixels, at the first count. The
last column is the time per sample, the fastest of interleaved runs. Counts that a sampler rounds up are marked with
the count that it took.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from lit_floor import floor_scene

SAMPLERS: dict[str, dict[str, Any]] = {
    "independent": {"type": "independent"},
    "stratified": {"type": "stratified"},
    "multijitter": {"type": "multijitter"},
    "orthogonal": {"type": "orthogonal"},
    "ldsampler": {"type": "ldsampler"},
    "sobol": {"type": "sobol"},
    "sobol, blue noise": {"type": "sobol", "blue_noise": True},
}

REFERENCE_SPP = 16384
TIMED_SPP = 1024
RUNS = 6


def scene(lit: str, size: int, sampler: dict[str, Any]) -> Any:
    """The Cornell box or the floor, `size` x `size` pixels, box filter."""
    if lit == "floor":
        sky = {"type": "constant", "radiance": 1.0}
        return djpt.load_dict(floor_scene({"sky": sky}, size=size, sampler=sampler))
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=size, height=size, rfilter={"type": "box"})
    description["sensor"]["sampler"] = sampler
    return djpt.load_dict(description)


def blurred(image: np.ndarray) -> np.ndarray:
    """Convolve an image with a Gaussian of 1.5 pixels, periodically."""
    frequency = [np.fft.fftfreq(n) for n in image.shape[:2]]
    squared = frequency[0][:, None, None] ** 2 + frequency[1][None, :, None] ** 2
    kernel = np.exp(-2 * (np.pi * 1.5) ** 2 * squared)
    return np.fft.ifft2(np.fft.fft2(image, axes=(0, 1)) * kernel, axes=(0, 1)).real


def errors(loaded: Any, spp: int, seeds: int, reference: np.ndarray) -> np.ndarray:
    """The differences from the reference, (seed, row, column, channel); 0 next to the lamp and in front of the sky."""
    dim = (reference.max(axis=2, keepdims=True) < 0.99).astype(float)
    # The error at the edges of lights would outweigh everything else.
    inner = np.min([np.roll(dim, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
    return np.array([(np.array(djpt.render(loaded, spp=spp, seed=s)) - reference) * inner for s in range(seeds)])


def rmse(e: np.ndarray) -> float:
    """The root mean square."""
    return float(np.sqrt(np.square(e).mean()))


def main() -> None:
    """Print one table per scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--spp", type=int, nargs="+", default=[4, 16, 64, 256])
    options = parser.parse_args()
    for lit in ("box", "floor"):
        scenes = {name: scene(lit, options.size, sampler) for name, sampler in SAMPLERS.items()}
        reference = np.array(djpt.render(scenes["independent"], spp=REFERENCE_SPP, seed=12345))
        times: dict[str, list[float]] = {name: [] for name in scenes}
        for seed in range(RUNS):
            for name, loaded in scenes.items():
                begin = time.perf_counter()
                np.array(djpt.render(loaded, spp=TIMED_SPP, seed=seed))
                spp = loaded.sensors()[0].sampler().round_count(TIMED_SPP)
                times[name].append((time.perf_counter() - begin) / (spp * options.size**2))
        print(f"\n{lit}\n{'sampler':20s}" + "".join(f"{spp:>15d}" for spp in options.spp) + "   blurred  ns/sample")
        plain: dict[int, float] = {}
        smooth = 0.0
        for name, loaded in scenes.items():
            line = ""
            for spp in options.spp:
                e = errors(loaded, spp, options.seeds, reference)
                taken = loaded.sensors()[0].sampler().round_count(spp)
                plain.setdefault(spp, rmse(e))
                if spp == options.spp[0]:
                    blur = rmse(np.array([blurred(image) for image in e]))
                    smooth = smooth or blur
                line += f"{rmse(e) / plain[spp]:8.2f} " + (f"({taken:4d})" if taken != spp else " " * 6)
            print(f"{name:20s}{line}{blur / smooth:9.2f} {min(times[name]) * 1e9:9.1f}", flush=True)


if __name__ == "__main__":
    main()
