"""Gradients of an image by every parameter of every emitter, against finite differences with the same seed.

Where light is linear in a parameter both agree to rounding. Angles and texels of lights whose sampling follows
them move samples: both then have the same mean.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from emitters import NAMES, entry, plugin_of
from lit_floor import floor_scene

import djpt
from djpt import ParamFlags

SIZE, SPP, STEP = 16, 64, 0.02
SEEDS, MORE_SEEDS = 4, 28


JUMPS = {"spot-checkerboard": {"light.cutoff_angle"}}
"""The squares of a checkerboard grow with the cone, and derivatives don't see edges that move."""


class Slopes:
    """The derivative of an image's mean in one direction of one parameter, by AD and by differences."""

    # What only turns the hue would cancel in a plain mean.
    weights = djpt.Float([1.5, 1.0, 0.5] * SIZE**2)

    def __init__(self, name: str, schedule: str = "auto") -> None:
        self.schedule = schedule
        integrator = {"type": "prb", "max_depth": 4, "rr_depth": 1000}
        self.scene = djpt.load_dict(floor_scene({"light": entry(name)}, size=SIZE, integrator=integrator))
        self.params = djpt.traverse(self.scene)
        self.keys = [
            key
            for key in self.params
            # Of a shape that shines, what the emitter in it has.
            if key.startswith("light.emitter." if "emitter" in entry(name) else "light.")
            and self.params.flags(key) & ParamFlags.Differentiable
            and key not in JUMPS.get(name, ())
        ]
        rng = np.random.default_rng(3)
        self.at, self.along = {}, {}
        for key in self.keys:
            value = numbers(self.params[key])
            # Off the ends of all ranges; angles in degrees have as much effect as other numbers by larger steps.
            degrees = key.endswith(("angle", "width"))
            self.at[key] = np.clip(value, 3, 80) * (0.8 if key.endswith("width") else 1) if degrees else value + 0.03
            self.along[key] = rng.uniform(0.5, 1, value.shape) * (10 if degrees else 1)
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


SEEN = [name for name in NAMES if plugin_of(name) != "directionalarea"]


@pytest.mark.parametrize("name", SEEN)
def test_every_parameter(name: str) -> None:
    slopes, exact = Slopes(name), {}
    assert slopes.keys
    verdicts = [slopes.check(key, exact) for key in slopes.keys]
    print(name, *(text for _, text in verdicts), sep="\n  ")
    assert all(good for good, _ in verdicts), "\n".join(text for good, text in verdicts if not good)
    assert any(exact[1][key] for key in slopes.keys)


@pytest.mark.parametrize("name", ["directional-turned", "projector-bitmap", "spot-turned", "spot-bitmap"])
def test_schedules_agree(name: str) -> None:
    """The same samples in another order."""
    flat, wave = (Slopes(name, schedule).attached(1) for schedule in ("flat", "wave"))
    largest = max(map(abs, flat.values()))
    for key, slope in flat.items():
        assert wave[key] == pytest.approx(slope, rel=1e-3, abs=1e-4 * largest), key


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("directional-turned", "light.irradiance.value"),
        ("projector-colour", "light.scale"),
        ("projector-bitmap", "light.irradiance.data"),
        ("spot-turned", "light.cutoff_angle"),
        ("spot-turned", "light.beam_width"),
        ("spot-bitmap", "light.texture.data"),
    ],
)
def test_wrong_derivatives_fail(name: str, key: str) -> None:
    """The test's power."""
    assert not Slopes(name).check(key, {}, 1.05)[0]


def test_a_hidden_light_has_no_gradient() -> None:
    with pytest.warns(UserWarning, match="can't show light"):
        assert Slopes("directionalarea-rectangle").attached(1) == {"light.emitter.radiance.value": 0.0}
