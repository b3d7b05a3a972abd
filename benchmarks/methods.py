"""Which method wins where: the tables of docs/theory/both-ends.md and points-and-beams.md.

    python benchmarks/methods.py [SCENE ..] [--methods ..] [--size N] [--spp N] [--seeds N]

Per scene and method: the gain, which is error times time of `path` over that of the method; in brackets the time of a
sample and the error, both as shares of those of `path`. The error is the mean square over all pixels but those that see
a lamp, directly, in mirrors or through glass, the bias against the mean of `bdpt` (`pool`: `sppm`) included; the time
is that of all processor cores, all that a method does before and after its samples included. Methods are those of
`djpt ladder` that reach all light of most scenes; in fog they are those that follow media, and `volpath` takes the
place of `path`.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import tempfile
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mesh_scenes
import numpy as np

from djpt.validation.integrator_comparison.steps import STEPS

FIRST = next(i for i, step in enumerate(STEPS) if step.title == "path")

METHODS = tuple(step.title for step in STEPS[FIRST:])
"""The integrators that are compared."""

IN_FOG = ("volpath", "bdpt", "sppm", "vcm", "upbp")
"""The integrators that are compared in fog."""

FOGGY = {"caustic_in_fog": "glass_ball", "lamp_in_glass_in_fog": "lamp_in_glass"}
"""The scenes in fog, and the built-in scenes that they are without it."""

DEPTH_IN_FOG = 8

REFERENCES = {"pool": "sppm"}
"""The methods whose mean images are the references of scenes in which those of `bdpt` are too noisy."""

SCENES = (
    "cornell_box",
    "mesh",
    "fixture",
    "lamp_in_glass",
    "glass_ball",
    "parabolic_mirror",
    "door_ajar",
    "pool",
    *FOGGY,
)
"""Built-in scenes, the Cornell box with a ball of triangles, and scenes in fog."""


def scene_of(name: str, size: int) -> dict[str, Any]:
    """The description of a scene, `size` x `size` pixels with a box filter."""
    scene = with_mesh() if name == "mesh" else djpt.scenes.SCENES[FOGGY.get(name, name)]()
    scene["sensor"]["film"].update(width=size, height=size, rfilter={"type": "box"})
    return scene


def with_mesh() -> dict[str, Any]:
    """The Cornell box with a bumpy ball of 20,000 triangles in the place of the small box."""
    scene = djpt.cornell_box()
    place = djpt.ScalarTransform4f().translate([0.4, -0.65, 0.35]).scale(0.3)
    file = str(mesh_scenes.write_bumpy_sphere(Path(tempfile.gettempdir()), 20_000))
    scene["small-box"] = {"type": "ply", "filename": file, "to_world": place, "bsdf": scene["small-box"]["bsdf"]}
    return scene


def in_fog(scene: dict[str, Any]) -> dict[str, Any]:
    """A scene with a glass ball, in thin fog that fills all space but the ball."""
    fog = {"type": "ref", "id": "fog"}
    scene["fog"] = {"type": "homogeneous", "id": "fog", "sigma_t": 0.3, "albedo": 0.9}
    scene["sensor"]["medium"] = scene["ball"]["exterior"] = fog
    return scene


def integrators(name: str, methods: Sequence[str], scene: Any) -> dict[str, dict[str, Any]]:
    """The descriptions of the integrators that are compared in a scene, by their titles; the first one is 1."""
    if name in FOGGY:
        return {title: {"type": title, "max_depth": DEPTH_IN_FOG} for title in IN_FOG}
    return {step.title: step.description(scene) for step in STEPS if step.title in methods}


def without_paint(node: dict[str, Any]) -> dict[str, Any]:
    """A description whose diffuse surfaces are black: its image shows lamps, also through glass and in mirrors."""
    copied = {key: without_paint(value) if isinstance(value, dict) else value for key, value in node.items()}
    if node.get("type") == "scene":
        copied["integrator"] = {"type": "path", "max_depth": 8}
    return {**copied, "reflectance": 0.0} if node.get("type") == "diffuse" else copied


@dataclass(frozen=True)
class Runs:
    """The images of a method."""

    images: np.ndarray
    """(seeds, pixels, 3)"""
    seconds: float
    """The median of the time of an image."""

    @property
    def variance(self) -> np.ndarray:
        """The variance of each pixel's channels."""
        return self.images.var(axis=0, ddof=1)

    def error(self, reference: Runs) -> float:
        """The mean squared error against the mean of other images, without the noise of either mean."""
        bias = np.square(self.images.mean(axis=0) - reference.images.mean(axis=0))
        noise = self.variance / len(self.images) + reference.variance / len(reference.images)
        same = self is reference
        return float(self.variance.mean()) + (0.0 if same else max(0.0, float((bias - noise).mean())))


def run(scene: Any, integrator: Any, spp: int, seeds: int, where: np.ndarray) -> Runs:
    """Render with seeds 0, 1, .., after an image whose time isn't counted, since kernels are compiled for it."""
    images, times = [], []
    for seed in range(-1, seeds):
        dr.sync_thread()
        start = time.process_time()
        image = np.array(djpt.render(scene, integrator=integrator, spp=spp, seed=max(seed, 0)), np.float64)
        times.append(time.process_time() - start)
        images.append(image[..., :3][where])
    return Runs(np.array(images[1:]), float(np.median(times[1:])))


def row(name: str, options: Any) -> str:
    """The row of a scene."""
    description = scene_of(name, options.size)
    lamps = np.array(djpt.render(djpt.load_dict(without_paint(description)), spp=16384))
    where = lamps.max(axis=2) == 0
    scene = djpt.load_dict(in_fog(description) if name in FOGGY else description)
    found = {}
    for title, integrator in integrators(name, options.methods, scene).items():
        found[title] = run(scene, djpt.load_dict(integrator), options.spp, options.seeds, where)
    first, cells = next(iter(found.values())), []
    reference = found.get(REFERENCES.get(name, "bdpt"), first)
    for runs in found.values():
        share, slower = runs.error(reference) / first.error(reference), runs.seconds / first.seconds
        cells.append(f"{1 / (share * slower):.2g} ({slower:.1f} x {share:.2g})")
    return f"| `{name}` | " + " | ".join(cells) + " |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=SCENES, metavar="SCENE")
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS, help="path must be among them")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--spp", type=int, default=1024)
    parser.add_argument("--seeds", type=int, default=32)
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # of what a method can't show in a scene
    for names, titles in (
        ([name for name in options.scenes if name not in FOGGY], [t for t in METHODS if t in options.methods]),
        ([name for name in options.scenes if name in FOGGY], IN_FOG),
    ):
        if names:
            print("| scene | " + " | ".join(f"`{title}`" for title in titles) + " |")
            print("|---" * (1 + len(titles)) + "|")
        for name in names:
            print(row(name, options), flush=True)


if __name__ == "__main__":
    main()
