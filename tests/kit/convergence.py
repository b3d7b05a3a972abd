"""Whether two integrators converge to one image: by the errors of independent renders."""

from __future__ import annotations

from typing import Any

import numpy as np

import djpt
from djpt.validation.statistics import Batches, block_test, mean_test

__all__ = ["assert_converges_to_path", "assert_equal_means", "images"]

BATCHES = 16
SIGNIFICANCE = 1e-4

ROUNDING = 1e-5
"""Images that differ by less, as a share of the brightest pixel, are the same: they may have no noise to compare."""


def images(scene: dict[str, Any], integrator: dict[str, Any], spp: int, first_seed: int = 3) -> list[np.ndarray]:
    """Independent images of 3 channels, `spp` samples per pixel each."""
    loaded, plugin = djpt.load_dict(scene), djpt.load_dict(integrator)
    seeds = range(first_seed, first_seed + BATCHES)
    return [np.array(djpt.render(loaded, integrator=plugin, spp=spp, seed=seed), np.float64) for seed in seeds]


def assert_equal_means(a: list[np.ndarray], b: list[np.ndarray], block: int = 4, where: Any = 1.0) -> None:
    """Assert that two series of images have equal means, as a whole and block by block; `where` weights the pixels."""
    ours, theirs = Batches(block), Batches(block)
    for image in a:
        ours.add(image * where)
    for image in b:
        theirs.add(image * where)
    for test in (mean_test, block_test):
        result = test(ours, theirs, SIGNIFICANCE, equal_variance=False)
        close = np.abs(ours.mean - theirs.mean).max() < ROUNDING * theirs.mean.max()
        assert result.passed or close, result


def assert_converges_to_path(
    name: str, integrator: dict[str, Any], spp: int, spp_of_path: int, unbounded: int = -1
) -> None:
    """Assert that an integrator shows a built-in scene as `path` does, at 32 x 32 pixels and the scene's own depth.

    Pixels at the edge of a lamp don't count: they are too noisy to tell anything. `unbounded` stands for the depth of
    scenes without a longest path.
    """
    scene = djpt.scenes.SCENES[name]()
    scene["sensor"]["film"].update(width=32, height=32, rfilter={"type": "box"})
    depth = scene["integrator"]["max_depth"]
    depth = unbounded if depth < 0 else depth
    bright = np.array(djpt.render(djpt.load_dict(scene), integrator=djpt.load_dict({"type": "path", "max_depth": 1})))
    share = bright / max(bright.max(), 1e-9)
    where = 1.0 * ((share < 1e-4) | (share > 1 - 1e-4) | (bright.min() > 0))
    ours = images(scene, {**integrator, "max_depth": depth}, spp)
    path = images(scene, {"type": "path", "max_depth": depth}, spp_of_path, 100)
    assert_equal_means(ours, path, where=where)
