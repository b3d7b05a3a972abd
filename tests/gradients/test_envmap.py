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
from djpt.validation.gradcheck.losses import Loss
from tests.kit.derivatives import mean_and_error
from tests.kit.lit_floor import floor_scene

ROWS, COLUMNS, SIZE = 6, 9, 20
DATA, SCALE = "light.data", "light.scale"
TEXELS = (0.1 + 2 * np.random.default_rng(4).random((ROWS, COLUMNS, 3)) ** 3).astype(np.float32)
TEXELS[1, 8] += 20
BLOCKS = [(slice(r, r + 2), slice(c, c + 3)) for r in (0, 2, 4) for c in (0, 3, 6)]
SINGLE = [(1, 8), (2, 0), (0, 4), (3, 5)]
"""The sun, a texel beside the seam, one at the pole, one near the horizon."""


class Lit(Loss):
    """The weighted mean of the image of the floor under a sky."""

    def __init__(self, integrator: str = "prb", spp: int = 16, **keys: Any) -> None:
        sky = {"type": "envmap", "data": TEXELS, "to_world": T().rotate([0, 1, 0], 40), **keys}
        description = {"type": integrator, "max_depth": 4, "rr_depth": 1000}
        if integrator == "direct":
            description = {"type": integrator}
        scene = djpt.load_dict(floor_scene({"light": sky}, size=SIZE, integrator=description))
        weights = np.broadcast_to(np.array([1.5, 1.0, 0.5], np.float32), (SIZE, SIZE, 3))
        super().__init__(scene, [DATA, SCALE], weights, spp=spp)

    def along(self, texels: np.ndarray, scale: float = 0.0) -> np.ndarray:
        """A change of all, or the values; columns beyond the seam repeat those at the other end."""
        entries = np.empty(self.values.size)
        entries[self.parts[DATA]] = np.concatenate([texels[:, -1:], texels, texels[:, :1]], axis=1).ravel()
        entries[self.parts[SCALE]] = scale
        return entries

    def gradient(self, seed: int) -> tuple[np.ndarray, float]:
        """In reverse mode: by the texels, and by the scale."""
        found = self.reverse(seed)
        by_data = found[self.parts[DATA]].reshape(ROWS, COLUMNS + 2, 3)
        assert not by_data[:, [0, -1]].any()  # the halo isn't read
        return by_data[:, 1:-1], float(found[self.parts[SCALE]][0])


@pytest.fixture
def fixed_densities(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Call it once the scene exists: the densities then stay as they are."""
    return lambda: monkeypatch.setattr(Hierarchical2D, "set", lambda self, values: None)


def one(*where: Any) -> np.ndarray:
    along = np.zeros(TEXELS.shape)
    along[where] = 1
    return along


@pytest.mark.sparse(6)
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
        expected = lit.value(lit.difference(lit.along(along), 0.1, 1))
        assert (by_data * along).sum() == pytest.approx(expected, rel=0.01, abs=1e-4 * largest)
    # Light is linear in the texels and in the scale.
    assert by_scale == pytest.approx(lit.value(lit.image(1)), rel=1e-4)
    assert (by_data * TEXELS).sum() == pytest.approx(by_scale, rel=1e-4)


def test_forward_is_reverse() -> None:
    lit = Lit()
    by_data, by_scale = lit.gradient(2)
    along = np.random.default_rng(1).uniform(0.5, 1, TEXELS.shape)
    for direction, expected in ((lit.along(along), (along * by_data).sum()), (lit.along(0 * along, 1), by_scale)):
        assert lit.value(lit.forward(direction, 2)) == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("where", [BLOCKS[0], BLOCKS[2], BLOCKS[4], SINGLE[0], SINGLE[3]], ids=str)
def test_moving_densities(where: Any) -> None:
    """Differences of scenes that sample by their own texels: within 1 % or 3 standard deviations."""
    lit, along = Lit(spp=64), one(*where)
    found, expected = [], []
    for seed in range(24):
        found.append((lit.gradient(seed)[0] * along).sum())
        expected.append(lit.value(lit.difference(lit.along(along), 0.05, seed)))
    error, sigma = mean_and_error(np.subtract(found, expected))
    assert abs(error) < max(3 * sigma, 0.01 * abs(np.mean(found)))


@pytest.mark.slow
def test_descending_the_gradient_finds_the_sky() -> None:
    """From grey light to the one whose shadows and colours are given."""
    lit = Lit()
    wanted = djpt.render(lit.scene, spp=256, seed=100)
    start = np.full(TEXELS.shape, 1.0)
    lit.move(lit.along(start, 1))
    texels, first, speed = start, None, np.zeros(TEXELS.shape)
    square = np.zeros(TEXELS.shape)
    for step in range(1, 81):
        attached, _ = lit.attach()
        image = djpt.render(lit.scene, lit.params, spp=16, seed=step)
        loss = dr.mean(dr.square(image.array - wanted.array))
        dr.backward(loss)
        slope = np.array(dr.grad(attached), np.float64)[:, 1:-1]
        first = float(loss[0]) if first is None else first
        # Adam.
        speed, square = 0.9 * speed + 0.1 * slope, 0.99 * square + 0.01 * slope**2
        texels = texels - 0.15 * (speed / (1 - 0.9**step)) / (np.sqrt(square / (1 - 0.99**step)) + 1e-8)
        texels = np.maximum(texels, 1e-3)
        lit.move(lit.along(texels, 1))
    image = djpt.render(lit.scene, lit.params, spp=256, seed=100)
    last = float(dr.mean(dr.square(image.array - wanted.array))[0])
    print(f"loss {first:.5f} -> {last:.5f}")
    assert last < 0.02 * first
