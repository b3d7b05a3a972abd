"""Gradients of an image by the texels of a light."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.jit.types import Float, TensorXf
from tests.kit.emitters import RECTANGLE
from tests.kit.kernels import kernels
from tests.kit.lit_floor import floor_scene

SIZE = 24
KEY = "light.emitter.radiance.data"
TEXELS = (0.2 + 5 * np.random.default_rng(4).random((3, 4, 3)) ** 3).astype(np.float32)
ALONG = np.random.default_rng(5).uniform(0.5, 1, TEXELS.shape).astype(np.float32)
STEP = 0.02
SHAPES = {
    "rectangle": RECTANGLE,
    "disk": {**RECTANGLE, "type": "disk"},
    "sphere": {"type": "sphere", "center": [-1, 1.5, 1.2], "radius": 0.5},
    "cube": {"type": "cube", "to_world": djpt.ScalarTransform4f().translate([-1, 1.5, 1.2]).scale(0.4)},
}
FILTERS = ("bilinear", "nearest")


class Lit:
    """A scene under a light with a bitmap, and the weighted mean of its image."""

    weights = Float([1.5, 1.0, 0.5] * SIZE**2)

    def __init__(
        self, texels: np.ndarray = TEXELS, shape: str = "rectangle", kind: str = "bilinear", integrator: str = "prb"
    ) -> None:
        texture = {"type": "bitmap", "data": TensorXf(texels), "raw": True, "filter_type": kind}
        light = {**SHAPES[shape], "emitter": {"type": "area", "radiance": texture}}
        # Without roulette, which follows the light, images are linear in the texels.
        description = floor_scene({"light": light}, size=SIZE, integrator={"type": integrator, "max_depth": 3})
        if integrator != "direct":
            description["integrator"]["rr_depth"] = 1000
        else:
            del description["integrator"]["max_depth"]
        self.scene = djpt.load_dict(description)
        self.params = djpt.traverse(self.scene)

    def put(self, texels: np.ndarray) -> None:
        self.params[KEY] = TensorXf(texels.astype(np.float32))
        self.params.update()

    def loss(self, spp: int, seed: int, **options: Any) -> Any:
        image = djpt.render(self.scene, self.params, spp=spp, seed=seed, seed_grad=seed, **options)
        return dr.mean(image.array * self.weights)

    def gradient(self, spp: int, seed: int, **options: Any) -> np.ndarray:
        """By each texel, in reverse mode."""
        dr.enable_grad(self.params[KEY])
        self.params.update()
        dr.backward(self.loss(spp, seed, **options))
        found = np.array(dr.grad(self.params[KEY]), np.float64)
        dr.disable_grad(self.params[KEY])
        self.params.update()
        return found

    def forward(self, spp: int, seed: int, **options: Any) -> float:
        """In the direction `ALONG`."""
        dr.enable_grad(self.params[KEY])
        dr.set_grad(self.params[KEY], TensorXf(ALONG))
        self.params.update()
        found = float(np.array(dr.forward_to(self.loss(spp, seed, **options))).item())
        dr.disable_grad(self.params[KEY])
        self.params.update()
        return found

    def difference(self, spp: int, seed: int) -> float:
        ends = []
        for sign in (1, -1):
            self.put(TEXELS + sign * STEP * ALONG)
            ends.append(float(self.loss(spp, seed)[0]))
        self.put(TEXELS)
        return (ends[0] - ends[1]) / (2 * STEP)


@pytest.mark.sparse(3)
@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("shape", SHAPES)
def test_by_differences(shape: str, kind: str) -> None:
    """Within 1 % or 3 standard deviations: differences also move the samples."""
    lit = Lit(shape=shape, kind=kind)
    slopes = [float((lit.gradient(64, seed) * ALONG).sum()) for seed in range(12)]
    errors = np.array(slopes) - [lit.difference(64, seed) for seed in range(12)]
    mean, sigma = errors.mean(), errors.std(ddof=1) / np.sqrt(len(errors))
    print(f"{shape} {kind}: {np.mean(slopes):.6f}, off by {mean:.6f} +- {sigma:.6f}")
    assert sigma < 0.05 * abs(np.mean(slopes))
    assert abs(mean) <= max(0.01 * abs(np.mean(slopes)), 3 * sigma)


@pytest.mark.parametrize("integrator", ["prb", "path", "direct"])
def test_forward_is_reverse(integrator: str) -> None:
    lit = Lit(integrator=integrator)
    reverse = float((lit.gradient(16, 1) * ALONG).sum())
    assert lit.forward(16, 1) == pytest.approx(reverse, rel=2e-4)
    assert reverse > 0


def test_schedules_agree() -> None:
    flat, wave = (Lit().gradient(16, 1, schedule=schedule) for schedule in ("flat", "wave"))
    np.testing.assert_allclose(wave, flat, rtol=1e-3, atol=1e-4 * np.abs(flat).max())


@pytest.mark.parametrize("kind", FILTERS)
def test_by_every_texel(kind: str) -> None:
    """Images are linear in texels: the derivative by one is the image that it makes alone, also if it is black now."""
    texels = TEXELS.copy()
    texels[1, 2] = 0
    lit = Lit(texels, kind=kind)
    found = np.array([lit.gradient(256, seed) for seed in range(4)]).mean(axis=0)
    for place in ((1, 2, 0), (0, 0, 1), (2, 3, 2), (1, 1, 0)):
        alone = np.zeros_like(texels)
        alone[place] = 1
        lit.put(alone)
        values = [float(lit.loss(256, seed)[0]) for seed in range(10, 14)]
        expected = np.mean(values)
        # A black texel is found by chance only.
        assert found[place] == pytest.approx(expected, rel=0.1 if texels[place] == 0 and kind == "nearest" else 0.05)


def test_densities_have_no_gradients() -> None:
    """Detached: the derivative times the value is the image's light, since it is linear."""
    lit = Lit()
    gradient = lit.gradient(16, 1)
    assert float((gradient * TEXELS).sum()) == pytest.approx(float(lit.loss(16, 1)[0]), rel=1e-3)


def test_descent_compiles_no_kernel() -> None:
    lit = Lit()

    def step(seed: int) -> None:
        lit.put(np.maximum(np.array(lit.params[KEY]) - 0.1 * lit.gradient(4, seed), 0))

    before = kernels(lambda: step(0)) | kernels(lambda: step(1))
    assert kernels(lambda: step(2)) <= before


def test_descent_from_black_finds_the_light() -> None:
    """From an image of a light back to its texels."""
    target = Lit()
    wanted = djpt.render(target.scene, spp=256, seed=9)
    lit = Lit(0 * TEXELS)
    optimiser_step, texels = 4.0, np.zeros_like(TEXELS)

    def loss() -> Any:
        image = djpt.render(lit.scene, lit.params, spp=64, seed=3)
        return dr.mean(dr.square(image.array - wanted.array))

    losses = []
    for _ in range(8):
        dr.enable_grad(lit.params[KEY])
        lit.params.update()
        value = loss()
        dr.backward(value)
        losses.append(float(value[0]))
        gradient = np.array(dr.grad(lit.params[KEY]))
        dr.disable_grad(lit.params[KEY])
        texels = np.maximum(texels - optimiser_step * gradient / np.abs(gradient).max() * 0.25, 0)
        lit.put(texels)
    assert losses[-1] < 0.2 * losses[0]
