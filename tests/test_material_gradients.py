"""Gradients of an image by every parameter of every material, against finite differences.

Differences of two images with one seed are noisy: a parameter moves the samples as well, and a choice that flips
moves them far. Derivatives keep the samples where they are. Both have the same mean.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from test_materials_same_seed import ball

import djpt
from djpt import ParamFlags
from materials import NAMES, bsdf, first_of_each

STEP = 0.02
SEEDS, MORE_SEEDS = 8, 40
SIZE, SPP = 24, 256


JUMPS = {"roughdielectric-ggx": {"ball.bsdf.eta"}, "roughdielectric-bubble": {"ball.bsdf.eta"}}
"""GGX has facets at right angles to the surface: refraction by them ends abruptly at directions that move with the
index, which differentiating at a fixed direction can't see. The parameter is flagged `Discontinuous`."""


class Slopes:
    """The derivative of an image's mean in one direction of one parameter, by AD and by differences."""

    # What only turns the hue would cancel in a plain mean.
    weights = djpt.Float([1.5, 1.0, 0.5] * SIZE**2)

    def __init__(self, name: str, schedule: str = "auto") -> None:
        self.schedule = schedule
        description = ball(bsdf(name), SIZE, "prb")
        # Roulette follows the brightest channel: differences then see it only where a decision flips, which is rare.
        description["integrator"]["rr_depth"] = 1000
        self.scene = djpt.load_dict(description)
        self.params = djpt.traverse(self.scene)
        self.keys = [
            key
            for key in self.params
            if key.startswith("ball.bsdf")
            and self.params.flags(key) & ParamFlags.Differentiable
            and key not in JUMPS.get(name, ())
        ]
        rng = np.random.default_rng(3)
        self.at, self.along = {}, {}
        for key in self.keys:
            value = numbers(self.params[key])
            # Off the ends of all ranges, so that there is room for a step on both sides.
            self.at[key] = 0.9 * value + 0.03
            self.along[key] = rng.uniform(0.5, 1, value.shape)
        self.put(self.at)

    def put(self, values: dict[str, Any]) -> None:
        for key, value in values.items():
            shape, kind = np.shape(value), type(self.params[key])
            flat = np.asarray(value, np.float32)
            self.params[key] = kind(flat) if len(shape) > 1 else kind(*np.atleast_1d(flat).tolist())
        self.params.update()

    def loss(self, seed: int) -> Any:
        image = djpt.render(self.scene, self.params, spp=SPP, seed=seed, seed_grad=seed, schedule=self.schedule)
        return dr.mean(image.array * self.weights)

    def attached(self, seed: int) -> dict[str, float]:
        """All directions at once."""
        self.put(self.at)
        for key in self.keys:
            dr.enable_grad(self.params[key])
        self.params.update()
        dr.backward(self.loss(seed))
        slopes = {key: float((numbers(dr.grad(self.params[key])) * self.along[key]).sum()) for key in self.keys}
        for key in self.keys:
            dr.disable_grad(self.params[key])
        self.params.update()
        return slopes

    def difference(self, key: str, seed: int) -> float:
        ends = []
        for sign in (1, -1):
            self.put({key: self.at[key] + sign * STEP * self.along[key]})
            ends.append(float(self.loss(seed)[0]))
        self.put({key: self.at[key]})
        return (ends[0] - ends[1]) / (2 * STEP)

    def check(self, key: str, exact: dict[int, dict[str, float]], factor: float = 1.0) -> tuple[bool, str]:
        """Are both within 1 % or 3 standard deviations? `factor` makes the derivative wrong."""
        errors: list[float] = []
        slopes: list[float] = []
        for count in (SEEDS, MORE_SEEDS):
            for seed in range(1 + len(errors), 1 + count):
                if seed not in exact:
                    exact[seed] = self.attached(seed)
                slopes.append(factor * exact[seed][key])
                errors.append(slopes[-1] - self.difference(key, seed))
            error, sigma = np.mean(errors), np.std(errors, ddof=1) / np.sqrt(len(errors))
            text = f"{key}: {np.mean(slopes):.6f}, off by {error:.6f} +- {sigma:.6f}"
            if abs(error) <= max(0.01 * abs(np.mean(slopes)), 3 * sigma):
                return True, text
        return False, text


def numbers(value: Any) -> np.ndarray:
    """A parameter as NumPy numbers: (), (3,) or a tensor's shape."""
    array = np.array(dr.detach(value), np.float64)
    return array if dr.is_tensor_v(value) else array.ravel() if dr.depth_v(value) > 1 else array.reshape(())


@pytest.mark.parametrize("name", first_of_each(NAMES))
def test_every_parameter(name: str) -> None:
    slopes, exact = Slopes(name), {}
    verdicts = [slopes.check(key, exact) for key in slopes.keys]
    print(name, *(text for _, text in verdicts), sep="\n  ")
    assert all(good for good, _ in verdicts), "\n".join(text for good, text in verdicts if not good)


@pytest.mark.parametrize("name", first_of_each(NAMES))
def test_schedules_agree(name: str) -> None:
    """The same samples in another order."""
    pair = [Slopes(name, schedule) for schedule in ("flat", "wave")]
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
    assert not Slopes(name).check(key, {}, factor)[0]
