"""Gradients of an image by the texels of a light."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.jit.types import TensorXf
from djpt.validation.gradcheck.losses import Loss
from tests.kit.derivatives import mean_and_error
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


WEIGHTS = np.broadcast_to(np.array([1.5, 1.0, 0.5], np.float32), (SIZE, SIZE, 3))


def lit(
    spp: int,
    texels: np.ndarray = TEXELS,
    shape: str = "rectangle",
    kind: str = "bilinear",
    integrator: str = "prb",
    **options: Any,
) -> Loss:
    """The weighted mean of the image of a scene under a light with a bitmap, as a function of its texels."""
    texture = {"type": "bitmap", "data": TensorXf(texels), "raw": True, "filter_type": kind}
    light = {**SHAPES[shape], "emitter": {"type": "area", "radiance": texture}}
    # Without roulette, which follows the light, images are linear in the texels.
    description = floor_scene({"light": light}, size=SIZE, integrator={"type": integrator, "max_depth": 3})
    if integrator != "direct":
        description["integrator"]["rr_depth"] = 1000
    else:
        del description["integrator"]["max_depth"]
    return Loss(djpt.load_dict(description), [KEY], WEIGHTS, spp=spp, **options)


@pytest.mark.sparse(9)
@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("shape", SHAPES)
def test_by_differences(shape: str, kind: str) -> None:
    """Within 1 % or 3 standard deviations: differences also move the samples."""
    loss = lit(64, shape=shape, kind=kind)
    slopes = [float(loss.reverse(seed) @ ALONG.ravel()) for seed in range(12)]
    differences = [loss.value(loss.difference(ALONG.ravel(), STEP, seed)) for seed in range(12)]
    mean, sigma = mean_and_error(np.subtract(slopes, differences))
    print(f"{shape} {kind}: {np.mean(slopes):.6f}, off by {mean:.6f} +- {sigma:.6f}")
    assert sigma < 0.05 * abs(np.mean(slopes))
    assert abs(mean) <= max(0.01 * abs(np.mean(slopes)), 3 * sigma)


@pytest.mark.parametrize("integrator", ["prb", "path", "direct"])
@pytest.mark.sparse(2)
def test_forward_is_reverse(integrator: str) -> None:
    loss = lit(16, integrator=integrator)
    reverse = float(loss.reverse(1) @ ALONG.ravel())
    assert loss.value(loss.forward(ALONG.ravel(), 1)) == pytest.approx(reverse, rel=2e-4)
    assert reverse > 0


def test_schedules_agree() -> None:
    flat, wave = (lit(16, schedule=schedule).reverse(1) for schedule in ("flat", "wave"))
    np.testing.assert_allclose(wave, flat, rtol=1e-3, atol=1e-4 * np.abs(flat).max())


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.sparse(2)
def test_by_every_texel(kind: str) -> None:
    """Images are linear in texels: the derivative by one is the image that it makes alone, also if it is black now."""
    texels = TEXELS.copy()
    texels[1, 2] = 0
    loss = lit(256, texels, kind=kind)
    found = np.mean([loss.reverse(seed) for seed in range(4)], axis=0).reshape(texels.shape)
    for place in ((1, 2, 0), (0, 0, 1), (2, 3, 2), (1, 1, 0)):
        alone = np.zeros_like(texels)
        alone[place] = 1
        loss.move(alone.ravel())
        expected = np.mean([loss.value(loss.image(seed)) for seed in range(10, 14)])
        # A black texel is found by chance only.
        assert found[place] == pytest.approx(expected, rel=0.1 if texels[place] == 0 and kind == "nearest" else 0.05)


def test_densities_have_no_gradients() -> None:
    """Detached: the derivative times the value is the image's light, since it is linear."""
    loss = lit(16)
    assert float(loss.reverse(1) @ loss.values) == pytest.approx(loss.value(loss.image(1)), rel=1e-3)


def test_descent_compiles_no_kernel() -> None:
    loss = lit(4)

    def step(seed: int) -> None:
        loss.move(np.maximum(loss.values - 0.1 * loss.reverse(seed), 0))

    before = kernels(lambda: step(0)) | kernels(lambda: step(1))
    assert kernels(lambda: step(2)) <= before


def test_descent_from_black_finds_the_light() -> None:
    """From an image of a light back to its texels."""
    wanted = djpt.render(lit(256).scene, spp=256, seed=9)
    dark, texels = lit(64, 0 * TEXELS), np.zeros(TEXELS.size)
    losses = []
    for _ in range(8):
        (attached,) = dark.attach()
        image = djpt.render(dark.scene, dark.params, spp=64, seed=3)
        value = dr.mean(dr.square(image.array - wanted.array))
        dr.backward(value)
        losses.append(float(value[0]))
        gradient = np.array(dr.grad(attached)).ravel()
        texels = np.maximum(texels - gradient / np.abs(gradient).max(), 0)
        dark.move(texels)
    assert losses[-1] < 0.2 * losses[0]
