"""Media that glow: closed forms, furnaces, derivatives, errors."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError
from tests.kit.media_scenes import GLASS, NULL, colour, fog, lit_ball
from tests.kit.renders import ours

INTEGRATORS = ["volpath", "volpathmis", "prbvolpath"]
BOX = T().translate([-1, -1, -1]).scale(2)


def through_the_middle(medium: dict[str, Any], integrator: str = "volpath") -> dict[str, Any]:
    """A ball that nothing shines on, seen along its diameter, of length 2."""
    scene = lit_ball(medium, integrator=integrator, size=4)
    del scene["sky"]
    scene["sensor"]["fov"] = 0.01
    return scene


def grid(values: Any) -> dict[str, Any]:
    """Numbers between -1 and 1 along each axis."""
    return {"type": "gridvolume", "data": np.asarray(values, np.float32), "to_world": BOX}


def smoke(sigma_t: Any, emission: Any, **more: Any) -> dict[str, Any]:
    """A medium that varies."""
    return {"type": "heterogeneous", "sigma_t": sigma_t, "emission": emission, **more}


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("sigma", [(0.2, 0.9, 3.0), (0.0, 1e-4, 0.02), (0.024, 0.026, 0.05)])
def test_a_ball_of_glowing_fog(integrator: str, sigma: tuple[float, ...]) -> None:
    """Q (1 - exp(-2 sigma)) / sigma, without noise; 2 Q where nothing is absorbed."""
    emission = np.array([0.5, 1.0, 2.0])
    image = ours(through_the_middle(fog(colour(*sigma), 0.0, emission=colour(*emission)), integrator), spp=4)
    x = 2 * np.array(sigma)
    expected = 2 * emission * np.divide(-np.expm1(-x), x, out=np.ones(3), where=x > 0)
    # Rays start a little beyond the surface: the length is 2 - 2e-4.
    np.testing.assert_allclose(image.reshape(-1, 3), np.tile(expected, (16, 1)), rtol=2e-4)


@pytest.mark.sparse(8)
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("tint", [(1.0,), (0.3, 1.0, 1.7)], ids=["grey", "coloured"])
def test_a_flame(integrator: str, tint: tuple[float, ...]) -> None:
    """Extinction and emission on grids, against a sum over the ray."""
    density = np.zeros((8, 1, 1, len(tint)))
    density[..., :] = np.linspace(0, 2.5, 8)[:, None, None, None] * np.array(tint)
    heat = np.linspace(1, 0.2, 8).reshape(8, 1, 1, 1) * np.array([1.0, 0.6, 0.1])
    scene = through_the_middle(smoke(grid(density), grid(heat), albedo=0.0), integrator)
    means = np.array([ours(scene, spp=1024, seed=seed).mean(axis=(0, 1)) for seed in range(8)])

    # The ray comes from +z. Grid points lie in the middle of their cells.
    z = 1 - (np.arange(4000) + 0.5) / 2000
    points = (np.arange(8) + 0.5) / 4 - 1
    tints = np.broadcast_to(tint, 3)
    sigma = np.interp(z, points, np.linspace(0, 2.5, 8))[:, None] * tints
    glow = np.interp(z, points, np.linspace(1, 0.2, 8))[:, None] * np.array([1.0, 0.6, 0.1])
    depth = (np.cumsum(sigma, axis=0) - sigma / 2) / 2000
    expected = (glow * np.exp(-depth)).sum(axis=0) / 2000
    error = means.std(axis=0, ddof=1) / np.sqrt(8)
    assert (np.abs(means.mean(axis=0) - expected) < 4 * error + 1e-4).all()
    np.testing.assert_allclose(means.mean(axis=0), expected, rtol=0.02)


# ---------------------------------------------------------------- furnaces


def rough(*channels: float) -> np.ndarray:
    """An uneven extinction, (Z, Y, X, C)."""
    return np.random.default_rng(1).uniform(0.2, 4, (5, 6, 7, 1)) * np.array(channels)


def furnace(name: str, q: float) -> dict[str, Any]:
    """A medium that emits `q` times what it absorbs, 0.4 of the extinction."""
    tint = np.array([0.4, 1, 1.5])
    return {
        "homogeneous": fog(2.0, 0.6, emission=0.8 * q),
        "forward": fog(2.0, 0.6, emission=0.8 * q, phase={"type": "hg", "g": 0.9}),
        "coloured": fog(colour(0.5, 1, 2), 0.6, emission=colour(0.2 * q, 0.4 * q, 0.8 * q)),
        "grid": smoke(grid(rough(1)), grid(0.4 * q * rough(1)), albedo=0.6),
        "coloured grid": smoke(grid(rough(*tint)), grid(0.4 * q * rough(*tint)), albedo=0.6),
    }[name]


SLOW = pytest.mark.slow
NAMES = ["homogeneous", "coloured grid", *(pytest.param(n, marks=SLOW) for n in ("forward", "coloured", "grid"))]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("bsdf", [NULL, pytest.param(GLASS, marks=SLOW)], ids=["null", "glass"])
@pytest.mark.sparse(2)
def test_equilibrium(name: str, bsdf: dict[str, Any]) -> None:
    """A medium that emits what it absorbs can't be seen under the sky of its own temperature.

    Within glass all radiance is larger, by the square of the index of refraction.
    """
    medium = furnace(name, 1.5**2 if bsdf is GLASS else 1.0)
    means = [ours(lit_ball(medium, bsdf, "volpathmis", size=8), spp=256, seed=s).mean((0, 1)) for s in range(8)]
    mean, error = np.mean(means, axis=0), np.std(means, axis=0, ddof=1) / np.sqrt(8)
    assert (np.abs(mean - 1) < 4 * error + 5e-4).all()
    assert np.abs(mean - 1).max() < 0.02


# ---------------------------------------------------------------- derivatives and parameters


def test_the_derivative_by_emission() -> None:
    """The image is proportional to it."""
    scene = djpt.load_dict(through_the_middle(fog(0.7, 0.0, emission=0.5)))
    params = djpt.traverse(scene)
    key = "ball.interior_medium.emission.value.value"
    value = djpt.Float(0.5)
    dr.enable_grad(value)
    params[key] = value
    params.update()
    dr.backward(dr.mean(djpt.render(scene, params, spp=4), axis=None))
    assert dr.grad(value)[0] == pytest.approx((1 - np.exp(-1.4)) / 0.7, rel=1e-4)


def test_the_derivative_by_the_extinction_of_a_glowing_medium() -> None:
    scene = djpt.load_dict(through_the_middle(fog(0.7, 0.0, emission=0.5)))
    params = djpt.traverse(scene)
    key = "ball.interior_medium.sigma_t.value.value"
    value = djpt.Float(0.7)
    dr.enable_grad(value)
    params[key] = value
    params.update()
    dr.backward(dr.mean(djpt.render(scene, params, spp=4), axis=None))
    s = 0.7
    expected = 0.5 * (2 * np.exp(-2 * s) / s - (1 - np.exp(-2 * s)) / s**2)
    assert dr.grad(value)[0] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("sigma", [(0.7,), (0.4, 0.7, 1.5)], ids=["grey", "coloured"])
@pytest.mark.sparse(2)
def test_derivatives_by_glowing_smoke(sigma: tuple[float, ...]) -> None:
    """By all texels of extinction and emission, which are the same everywhere: closed forms."""
    s, heat = np.array(sigma), np.array([0.5, 1.0, 2.0])
    density = np.broadcast_to(s, (2, 2, 2, len(s))).astype(np.float32)
    glow = np.broadcast_to(heat, (2, 2, 2, 3)).astype(np.float32)
    scene = djpt.load_dict(through_the_middle(smoke(grid(density), grid(glow), albedo=0.0), "prbvolpath"))
    params = djpt.traverse(scene)
    leaves = {name: djpt.TensorXf(value) for name, value in (("sigma_t", density), ("emission", glow))}
    for name, leaf in leaves.items():
        dr.enable_grad(leaf)
        params[f"ball.interior_medium.{name}.data"] = leaf
    params.update()
    dr.backward(dr.mean(djpt.render(scene, params, spp=1, spp_grad=8192), axis=None))
    by_sigma, by_heat = (np.array(dr.grad(leaf)).sum(axis=(0, 1, 2)) for leaf in leaves.values())
    expected = heat * (2 * np.exp(-2 * s) / s - (1 - np.exp(-2 * s)) / s**2) / 3
    np.testing.assert_allclose(by_sigma, expected if len(s) == 3 else [expected.sum()], rtol=0.03)
    np.testing.assert_allclose(by_heat, np.broadcast_to((1 - np.exp(-2 * s)) / s / 3, 3), rtol=0.02)


def test_what_glows_needs_no_other_light() -> None:
    with pytest.raises(djpt.errors.RenderError, match="no emitter"):
        ours(through_the_middle(fog(1.0)), spp=1)
    assert ours(through_the_middle(fog(1.0, emission=1.0)), spp=1).min() > 0


@pytest.mark.parametrize(
    ("medium", "message"),
    [
        (fog(emission=-1.0), "'emission' must be at least 0, found -1"),
        (fog(emission=grid(np.ones((2, 2, 2)))), "'emission' must be the same everywhere"),
    ],
)
def test_errors(medium: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(medium)
