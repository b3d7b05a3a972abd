"""Gradients of an image by every parameter of every material, against finite differences.

Differences of two images with one seed are noisy: a parameter moves the samples as well, and a choice that flips
moves them far. Derivatives keep the samples where they are. Both have the same mean.
"""

from __future__ import annotations

import numpy as np
import pytest

from djpt import ParamFlags
from tests.kit.materials import NAMES, bsdf, first_of_each
from tests.kit.slopes import Slopes, numbers
from tests.materials.test_same_seed import ball

JUMPS = {"roughdielectric-ggx": {"ball.bsdf.eta"}, "roughdielectric-bubble": {"ball.bsdf.eta"}}
"""GGX has facets at right angles to the surface: refraction by them ends abruptly at directions that move with the
index, which differentiating at a fixed direction can't see. The parameter is flagged `Discontinuous`."""


class MaterialSlopes(Slopes):
    """By the parameters of a material on a ball."""

    size, spp, seeds = 24, 256, (8, 40)

    def __init__(self, name: str, schedule: str = "auto") -> None:
        description = ball(bsdf(name), self.size, "prb")
        # Roulette follows the brightest channel: differences then see it only where a decision flips, which is rare.
        description["integrator"]["rr_depth"] = 1000
        super().__init__(description, schedule)
        self.keys = [
            key
            for key in self.params
            if key.startswith("ball.bsdf")
            and self.params.flags(key) & ParamFlags.Differentiable
            and key not in JUMPS.get(name, ())
        ]
        rng = np.random.default_rng(3)
        for key in self.keys:
            value = numbers(self.params[key])
            # Off the ends of all ranges, so that there is room for a step on both sides.
            self.at[key] = 0.9 * value + 0.03
            self.along[key] = rng.uniform(0.5, 1, value.shape)
        self.put(self.at)


@pytest.mark.parametrize("name", first_of_each(NAMES))
def test_every_parameter(name: str) -> None:
    slopes, exact = MaterialSlopes(name), {}
    verdicts = [slopes.check(key, exact) for key in slopes.keys]
    print(name, *(text for _, text in verdicts), sep="\n  ")
    assert all(good for good, _ in verdicts), "\n".join(text for good, text in verdicts if not good)


@pytest.mark.parametrize("name", first_of_each(NAMES))
def test_schedules_agree(name: str) -> None:
    """The same samples in another order."""
    pair = [MaterialSlopes(name, schedule) for schedule in ("flat", "wave")]
    if not pair[0].keys:
        pytest.skip("no parameter has a gradient")
    flat, wave = (slopes.attached(1) for slopes in pair)
    largest = max(map(abs, flat.values()))
    for key, slope in flat.items():
        assert wave[key] == pytest.approx(slope, rel=1e-3, abs=1e-4 * largest), key


@pytest.mark.parametrize(
    ("name", "key", "factor"),
    [
        ("diffuse-colour", "ball.bsdf.reflectance.value", 1.05),
        ("roughconductor-gold", "ball.bsdf.alpha.value", -1.0),
        ("plastic-colour", "ball.bsdf.diffuse_reflectance.value", 1.05),
        ("diffuse-bitmap", "ball.bsdf.reflectance.data", 1.05),
        ("mask-diffuse", "ball.bsdf.opacity.value", -1.0),
        ("principledthin-everything", "ball.bsdf.sheen_tint.value", 1.05),
    ],
)
def test_wrong_derivatives_fail(name: str, key: str, factor: float) -> None:
    """The test's power."""
    assert not MaterialSlopes(name).check(key, {}, factor)[0]
