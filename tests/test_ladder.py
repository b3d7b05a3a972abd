"""The integrators of the teaching texts: all of them tell the same story, with more or less noise."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from lit_floor import floor_scene
from renders import box

import djpt

NAIVE: list[dict[str, Any]] = [
    {"type": "path_naive", "hemisphere": "uniform"},
    {"type": "path_naive", "hemisphere": "cosine"},
    {"type": "path_nee"},
]


def images(scene: Any, integrator: dict[str, Any], spp: int, seeds: int, depth: int = 6) -> np.ndarray:
    plugin = djpt.load_dict({"max_depth": depth, **integrator})
    return np.stack([np.array(djpt.render(scene, integrator=plugin, spp=spp, seed=7 + s)) for s in range(seeds)])


def z_score(a: np.ndarray, b: np.ndarray) -> float:
    """Of the difference of two sets of images' means; independent images."""
    x, y = a.mean(axis=(1, 2, 3)), b.mean(axis=(1, 2, 3))
    return abs(x.mean() - y.mean()) / np.sqrt(x.var(ddof=1) / len(x) + y.var(ddof=1) / len(y))


def shiny(scene: dict[str, Any]) -> dict[str, Any]:
    """With glass, rough metal, rough glass, and a surface that has both a mirror and a smooth lobe."""
    scene["ball"]["bsdf"] = {"type": "dielectric"}
    scene["small"]["bsdf"] = {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.2, 0.5, 0.7]}}
    scene["gold"] = {
        "type": "sphere",
        "center": [0.2, -0.6, -0.9],
        "radius": 0.4,
        "bsdf": {"type": "roughconductor", "material": "Au", "alpha": 0.4},
    }
    scene["frosted"] = {
        "type": "sphere",
        "center": [0.1, -0.7, 1.6],
        "radius": 0.3,
        "bsdf": {"type": "roughdielectric", "alpha": 0.4},
    }
    scene["sky"] = {"type": "constant", "radiance": 0.3}
    return scene


@pytest.mark.parametrize("integrator", NAIVE, ids=str)
@pytest.mark.parametrize("materials", ["diffuse", "shiny"])
def test_same_mean_as_path(integrator: dict[str, Any], materials: str) -> None:
    big = {"type": "sphere", "center": [-1, 3, 1], "radius": 1.2, "emitter": {"type": "area", "radiance": 3.0}}
    description = floor_scene({"big": big}, size=16)
    scene = djpt.load_dict(shiny(description) if materials == "shiny" else description)
    assert z_score(images(scene, integrator, 256, 16), images(scene, {"type": "path"}, 128, 16)) < 4


def test_each_step_lowers_the_variance() -> None:
    scene = djpt.load_dict(box(32))
    variances = [images(scene, i, 64, 4).var(axis=0).mean() for i in (*NAIVE, {"type": "path"})]
    assert variances[0] > 1.3 * variances[1]
    assert variances[1] > 2 * variances[2]
    assert variances[2] >= 0.95 * variances[3]


def test_point_lights_need_light_sampling() -> None:
    lamp = {"type": "point", "position": [0, 2, 2], "intensity": 3.0}
    scene = djpt.load_dict(floor_scene({"lamp": lamp}, size=8))
    assert images(scene, {"type": "path_naive"}, 16, 1).max() == 0
    assert images(scene, {"type": "path_nee"}, 16, 1).mean() > 0.01


def test_paths_that_never_end_are_refused() -> None:
    with pytest.raises(djpt.SceneError, match="russian_roulette"):
        djpt.load_dict({"type": "path_nee", "russian_roulette": 1.0})
    with pytest.raises(djpt.SceneError, match="russian_roulette"):
        djpt.load_dict({"type": "path_nee", "russian_roulette": 0.0})


@pytest.mark.parametrize("integrator", NAIVE, ids=str)
def test_gradients_by_replay(integrator: dict[str, Any]) -> None:
    """Images are linear in the light's radiance, here 1: with the same samples the derivative is the image."""
    lamp = {"type": "sphere", "center": [-1, 3, 1], "radius": 1.2, "emitter": {"type": "area"}}
    scene = djpt.load_dict(floor_scene({"lamp": lamp}, size=16))
    plugin = djpt.load_dict({"max_depth": 4, **integrator})
    params = djpt.traverse(scene)
    radiance = params["lamp.emitter.radiance.value"]
    dr.enable_grad(radiance)
    params.update()
    loss = dr.mean(djpt.render(scene, integrator=plugin, spp=16, seed=3, seed_grad=3), axis=None)
    dr.backward(loss)
    assert float(dr.sum(dr.grad(radiance))[0]) == pytest.approx(float(loss.numpy()), rel=1e-4)
