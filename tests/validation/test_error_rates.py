"""How often a whole comparison is wrong: false alarms of equal renderers, and biases that it misses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.scenes.overrides import override
from djpt.validation import compare_renderers
from djpt.validation.compare import djpt_renderer

pytest.importorskip("scipy")

Renderer = Callable[[int, int], Any]


def fireflies(spp: int, seed: int) -> np.ndarray:
    """A gradient with skewed noise: one sample in fifty is fifty times as bright as the mean."""
    rng = np.random.default_rng(seed)
    bright = rng.binomial(spp, 0.02, (24, 32, 3)) / (0.02 * spp)
    return np.linspace(0.1, 1, 24 * 32 * 3).reshape(24, 32, 3) * (0.5 + 0.5 * bright)


def box(size: int, rfilter: str) -> Renderer:
    return djpt_renderer(override(djpt.cornell_box(), width=size, height=size, rfilter=rfilter))


def alarms(ours: Renderer, theirs: Renderer, count: int, **options: Any) -> int:
    """How many of some comparisons fail."""
    return sum(not compare_renderers(ours, theirs, seed=k, same_seed_spp=0, **options).passed for k in range(count))


def test_skewed_noise_raises_few_alarms() -> None:
    assert alarms(fireflies, fireflies, 20, spp=64, independent_pixels=True) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("independent", [True, False])
def test_false_alarms_of_skewed_noise(independent: bool) -> None:
    assert alarms(fireflies, fireflies, 400, spp=64, independent_pixels=independent) < 0.02 * 400


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_false_alarms_of_renders(rfilter: str) -> None:
    renderer = box(16, rfilter)
    assert alarms(renderer, renderer, 300, spp=64, independent_pixels=rfilter == "box") < 0.02 * 300


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_a_bias_of_one_percent_is_found(rfilter: str) -> None:
    """64 x 64 pixels with 256 samples are a million samples."""
    renderer = box(64, rfilter)
    biased: Renderer = lambda spp, seed: 1.01 * renderer(spp, seed)  # noqa: E731
    found = alarms(biased, renderer, 100, spp=256, independent_pixels=rfilter == "box")
    assert found >= 95
