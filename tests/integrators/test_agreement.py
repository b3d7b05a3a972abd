"""Every unbiased integrator converges to the same image, which is that of Mitsuba's `path`.

All of them render with seeds of their own, in batches; Welch's test then asks whether noise explains the difference
from the reference's batches, for the image's mean and for blocks of 8 x 8 pixels, in each channel. Each of the two
families has a chance of 1e-4 to alarm falsely (Sidak): the mean of a channel may be 4.15 deviations off, a block 4.75.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.validation import mitsuba_renderer
from djpt.validation.statistics import Batches, TestResult, block_test, mean_test

pytest.importorskip("mitsuba")

SIGNIFICANCE = 1e-4
BATCHES = 16
BLOCK = 8
Render = Callable[[int, int], np.ndarray]


@dataclass(frozen=True)
class Step:
    """An integrator, and the image that it is to converge to: that of paths of at most `depth` edges."""

    type: str
    depth: int = 7
    keys: dict[str, Any] = field(default_factory=dict)
    sampler: str = "independent"
    effort: int = 1
    """Samples per sample of the others."""

    def integrator(self) -> Any:
        """The plugin."""
        depth = {} if self.type == "direct" else {"max_depth": self.depth}
        return djpt.load_dict({"type": self.type, **depth, **self.keys})


# Roulette begins early: it is to be tested as well.
STEPS: dict[str, Step] = {
    # Rough glass gives these two, which know nothing of the material, a few very bright paths; more so with each hit.
    "path_naive, uniform": Step("path_naive", 5, {"hemisphere": "uniform", "rr_depth": 3}, effort=8),
    "path_naive, cosine": Step("path_naive", 5, {"hemisphere": "cosine", "rr_depth": 3}, effort=8),
    "path_nee": Step("path_nee"),
    "path_nee, q = 0.5": Step("path_nee", keys={"russian_roulette": 0.5}),
    "path": Step("path", keys={"rr_depth": 3}),
    "path, power": Step("path", keys={"emitter_choice": "power"}),
    "path, tree": Step("path", keys={"emitter_choice": "tree"}),
    "path, Sobol": Step("path", sampler="sobol"),
    "path, its bounces": Step("path", keys={"bounces": True}),
    "prb": Step("prb", keys={"rr_depth": 3}),
    "prb_basic": Step("prb_basic", effort=8),
    "ptracer": Step("ptracer", keys={"rr_depth": 3}),
    "ptracer, power": Step("ptracer", keys={"emitter_choice": "power"}),
    "ptracer, Sobol": Step("ptracer", sampler="sobol"),
    "bdpt": Step("bdpt", keys={"rr_depth": 3}),
    "bdpt, balance": Step("bdpt", keys={"heuristic": "balance", "emitter_choice": "power"}),
    "bdpt, Sobol": Step("bdpt", sampler="sobol"),
    "guided": Step("guided", keys={"rr_depth": 3}),
    "guided, Sobol": Step("guided", sampler="sobol"),
    "distributed": Step("distributed", 3, {"split": 3, "light_samples": 2}),
    "distributed, tree": Step("distributed", 3, {"split": 2, "light_samples": 1, "emitter_choice": "tree"}),
    "direct": Step("direct", 2),
    "direct, more BSDF samples": Step("direct", 2, {"emitter_samples": 1, "bsdf_samples": 3}),
    "direct, tree": Step("direct", 2, {"emitter_choice": "tree"}),
}


def cornell() -> dict[str, Any]:
    """Diffuse surfaces and a small lamp."""
    return djpt.cornell_box()


def furnace() -> dict[str, Any]:
    """Every surface shines: 9 lamps, 21 sides."""
    return djpt.scenes.furnace(0.6, 1.0)


def glass_and_metal() -> dict[str, Any]:
    """Balls of glass, frosted glass, rough gold and plastic in the Cornell box: caustics of three large lights."""
    scene = djpt.cornell_box()
    del scene["small-box"], scene["large-box"]
    scene["light"]["to_world"] = T().translate([0, 0.99, 0]).rotate([1, 0, 0], 90).scale(0.7)
    scene["light"]["emitter"]["radiance"] = {"type": "rgb", "value": [3.0, 2.5, 2.0]}
    ball_lamp = {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 2.0, 4.0]}}
    scene["lamp"] = {"type": "sphere", "center": [0.5, 0.35, 0.0], "radius": 0.3, "emitter": ball_lamp}
    scene["sky"] = {"type": "constant", "radiance": 0.3}
    balls: dict[str, tuple[list[float], float, dict[str, Any]]] = {
        "glass": ([-0.45, -0.6, 0.3], 0.38, {"type": "dielectric"}),
        "frosted": ([0.5, -0.65, 0.45], 0.33, {"type": "roughdielectric", "alpha": 0.7}),
        "gold": ([0.05, -0.55, -0.45], 0.4, {"type": "roughconductor", "material": "Au", "alpha": 0.5}),
        "plastic": ([-0.55, 0.3, -0.5], 0.3, {"type": "roughplastic", "alpha": 0.2}),
    }
    for name, (center, radius, bsdf) in balls.items():
        scene[name] = {"type": "sphere", "center": center, "radius": radius, "bsdf": bsdf}
    return scene


SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "cornell": cornell,
    "furnace": furnace,
    "glass and metal": glass_and_metal,
}


def description(scene: str, size: int, depth: int, sampler: str = "independent") -> dict[str, Any]:
    """One of the scenes with a small film; `size` x `size` pixels that share no samples."""
    result = SCENES[scene]()
    result["sensor"]["film"].update(width=size, height=size, rfilter={"type": "box"})
    result["sensor"]["sampler"] = {"type": sampler}
    result["integrator"] = {"type": "path", "max_depth": depth}
    return result


def seen(scene: str, size: int, name: str) -> np.ndarray:
    """Which share of each pixel the shape `name` takes, (H, W, 1)."""
    alone = description(scene, size, depth=1)
    alone.pop("sky", None)
    for node in alone.values():
        if isinstance(node, dict):
            node.pop("emitter", None)
    if name not in alone:
        return np.zeros((size, size, 1))
    alone[name]["emitter"] = {"type": "area", "radiance": 1.0}
    return np.array(djpt.render(djpt.load_dict(alone), spp=256))[..., :1]


@lru_cache
def edges(scene: str, size: int) -> np.ndarray:
    """The pixels that a bright lamp covers in part: their noise would drown all else in the image's mean."""
    lamp = seen(scene, size, "light")
    return (lamp > 0) & (lamp < 1)


@lru_cache
def smooth_glass(scene: str, size: int) -> np.ndarray:
    """The pixels that show things through smooth glass, which light paths can't."""
    return seen(scene, size, "glass") > 0


def batches(render: Render, spp: int, first_seed: int) -> list[np.ndarray]:
    """Independent images, of `spp` samples per pixel in all."""
    return [render(spp // BATCHES, first_seed + k) for k in range(BATCHES)]


@lru_cache
def reference(scene: str, size: int, depth: int, spp: int) -> list[np.ndarray]:
    """What Mitsuba's `path` renders."""
    return batches(mitsuba_renderer(description(scene, size, depth)), spp, first_seed=1000)


def compared(scene: str, name: str, size: int, spp: int) -> list[TestResult]:
    """The tests of the mean and of the blocks."""
    step = STEPS[name]
    loaded, integrator = djpt.load_dict(description(scene, size, step.depth, step.sampler)), step.integrator()

    def render(spp: int, seed: int) -> np.ndarray:
        image = np.array(djpt.render(loaded, integrator=integrator, spp=spp, seed=seed))
        return image[..., 3:].reshape(size, size, -1, 3).sum(axis=2) if "bounces" in step.keys else image

    hidden = edges(scene, size) | (smooth_glass(scene, size) & (step.type == "ptracer"))
    assert hidden.mean() < 0.25
    ours, theirs = Batches(BLOCK), Batches(BLOCK)
    for image in batches(render, step.effort * spp, first_seed=0):
        ours.add(np.where(hidden, 0, image))
    for image in reference(scene, size, step.depth, spp):
        theirs.add(np.where(hidden, 0, image))
    return [test(ours, theirs, SIGNIFICANCE, equal_variance=False) for test in (mean_test, block_test)]


# Glass and metal ask most of an integrator; what it can do there it can do in the other scenes.
QUICK = [pytest.param(scene, marks=() if scene == "glass and metal" else pytest.mark.slow) for scene in SCENES]


@pytest.mark.sparse(30)
@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize("scene", QUICK)
def test_small_images(scene: str, name: str) -> None:
    """Half a million samples: biases of a per cent or two are seen, and of a few per cent in a block."""
    for result in compared(scene, name, 32, 512):
        assert result.passed, result


@pytest.mark.slow
@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize("scene", SCENES)
def test_two_million_samples(scene: str, name: str) -> None:
    for result in compared(scene, name, 32, 2048):
        assert result.passed, result


@pytest.mark.slow
def test_one_bounce_less_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(STEPS, "short", Step("path", keys={"max_depth": 6}))
    assert not all(result.passed for result in compared("furnace", "short", 32, 512))
