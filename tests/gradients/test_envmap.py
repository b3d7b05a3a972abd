"""Gradients of images by the texels and the scale of an environment map.

With the densities kept as they were, images at one seed are linear in both, so that differences are exact.
Densities that follow the texels change the samples: then only the means agree.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.distributions import Hierarchical2D
from djpt.jit.types import Float, TensorXf
from tests.kit.lit_floor import floor_scene

ROWS, COLUMNS, SIZE = 6, 9, 20
DATA, SCALE = "light.data", "light.scale"
TEXELS = (0.1 + 2 * np.random.default_rng(4).random((ROWS, COLUMNS, 3)) ** 3).astype(np.float32)
TEXELS[1, 8] += 20
BLOCKS = [(slice(r, r + 2), slice(c, c + 3)) for r in (0, 2, 4) for c in (0, 3, 6)]
SINGLE = [(1, 8), (2, 0), (0, 4), (3, 5)]
"""The sun, a texel beside the seam, one at the pole, one near the horizon."""


class Lit:
    """The floor under a sky, and the weighted mean of its image."""

    weights = Float([1.5, 1.0, 0.5] * SIZE**2)

    def __init__(self, integrator: str = "prb", **keys: Any) -> None:
        sky = {"type": "envmap", "data": TEXELS, "to_world": T().rotate([0, 1, 0], 40), **keys}
        description = {"type": integrator, "max_depth": 4, "rr_depth": 1000}
        if integrator == "direct":
            description = {"type": integrator}
        self.scene = djpt.load_dict(floor_scene({"light": sky}, size=SIZE, integrator=description))
        self.params = djpt.traverse(self.scene)

    def put(self, texels: np.ndarray, scale: float = 1.0) -> None:
        halo = np.concatenate([texels[:, -1:], texels, texels[:, :1]], axis=1)
        self.params.update({DATA: TensorXf(halo.astype(np.float32)), SCALE: scale})

    def loss(self, seed: int, spp: int = 16) -> Any:
        image = djpt.render(self.scene, self.params, spp=spp, seed=seed, seed_grad=seed)
        return dr.mean(image.array * self.weights)

    def gradient(self, seed: int, spp: int = 16) -> tuple[np.ndarray, float]:
        """In reverse mode: by the texels, and by the scale."""
        for key in (DATA, SCALE):
            dr.enable_grad(self.params[key])
        self.params.update()
        dr.backward(self.loss(seed, spp))
        by_data, by_scale = np.array(dr.grad(self.params[DATA]), np.float64), float(dr.grad(self.params[SCALE])[0])
        for key in (DATA, SCALE):
            dr.disable_grad(self.params[key])
        self.params.update()
        assert not by_data[:, [0, -1]].any()  # the halo isn't read
        return by_data[:, 1:-1], by_scale

    def difference(self, along: np.ndarray, seed: int, step: float, spp: int = 16) -> float:
        ends = []
        for sign in (1, -1):
            self.put(TEXELS + sign * step * along)
            ends.append(float(self.loss(seed, spp)[0]))
        self.put(TEXELS)
        return (ends[0] - ends[1]) / (2 * step)


@pytest.fixture
def fixed_densities(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Call it once the scene exists: the densities then stay as they are."""
    return lambda: monkeypatch.setattr(Hierarchical2D, "set", lambda self, values: None)


def one(*where: Any) -> np.ndarray:
    along = np.zeros(TEXELS.shape)
    along[where] = 1
    return along


@pytest.mark.sparse(3)
@pytest.mark.parametrize("keys", [{}, {"mis_compensation": True}], ids=["plain", "compensated"])
@pytest.mark.parametrize("integrator", ["prb", "path", "direct"])
def test_same_samples(integrator: str, keys: dict[str, Any], fixed_densities: Any) -> None:
    """By blocks of texels, by single texels and by the scale."""
    lit = Lit(integrator, **keys)
    by_data, by_scale = lit.gradient(1)
    fixed_densities()
    largest = np.abs(by_data).max()
    for where in [*BLOCKS, *SINGLE]:
        along = one(*where)
        expected = lit.difference(along, 1, 0.1)
        assert (by_data * along).sum() == pytest.approx(expected, rel=0.01, abs=1e-4 * largest)
    # Light is linear in the texels and in the scale.
    assert by_scale == pytest.approx(float(lit.loss(1)[0]), rel=1e-4)
    assert (by_data * TEXELS).sum() == pytest.approx(by_scale, rel=1e-4)


def test_forward_is_reverse() -> None:
    lit = Lit()
    by_data, by_scale = lit.gradient(2)
    along = np.random.default_rng(1).uniform(0.5, 1, (ROWS, COLUMNS + 2, 3))
    for key, tangent, expected in (
        (DATA, TensorXf(along.astype(np.float32)), (along[:, 1:-1] * by_data).sum()),
        (SCALE, Float(1), by_scale),
    ):
        dr.enable_grad(lit.params[key])
        dr.set_grad(lit.params[key], tangent)
        lit.params.update()
        found = float(dr.forward_to(lit.loss(2))[0])
        dr.disable_grad(lit.params[key])
        lit.params.update()
        assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("where", [BLOCKS[0], BLOCKS[2], BLOCKS[4], SINGLE[0], SINGLE[3]], ids=str)
def test_moving_densities(where: Any) -> None:
    """Differences of scenes that sample by their own texels: within 1 % or 3 standard deviations."""
    lit, along = Lit(), one(*where)
    found, expected = [], []
    for seed in range(24):
        found.append((lit.gradient(seed, 64)[0] * along).sum())
        expected.append(lit.difference(along, seed, 0.05, 64))
    error = np.subtract(found, expected)
    sigma = error.std(ddof=1) / np.sqrt(len(error))
    assert abs(error.mean()) < max(3 * sigma, 0.01 * abs(np.mean(found)))


@pytest.mark.slow
def test_descending_the_gradient_finds_the_sky() -> None:
    """From grey light to the one whose shadows and colours are given."""
    lit = Lit()
    wanted = djpt.render(lit.scene, spp=256, seed=100)
    start = np.full(TEXELS.shape, 1.0)
    lit.put(start)
    texels, first, speed = start, None, np.zeros(TEXELS.shape)
    square = np.zeros(TEXELS.shape)
    for step in range(1, 81):
        dr.enable_grad(lit.params[DATA])
        lit.params.update()
        image = djpt.render(lit.scene, lit.params, spp=16, seed=step)
        loss = dr.mean(dr.square(image.array - wanted.array))
        dr.backward(loss)
        slope = np.array(dr.grad(lit.params[DATA]), np.float64)[:, 1:-1]
        dr.disable_grad(lit.params[DATA])
        first = float(loss[0]) if first is None else first
        # Adam.
        speed, square = 0.9 * speed + 0.1 * slope, 0.99 * square + 0.01 * slope**2
        texels = texels - 0.15 * (speed / (1 - 0.9**step)) / (np.sqrt(square / (1 - 0.99**step)) + 1e-8)
        texels = np.maximum(texels, 1e-3)
        lit.put(texels)
    image = djpt.render(lit.scene, lit.params, spp=256, seed=100)
    last = float(dr.mean(dr.square(image.array - wanted.array))[0])
    print(f"loss {first:.5f} -> {last:.5f}")
    assert last < 0.02 * first
