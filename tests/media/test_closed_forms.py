"""Media in closed form: what scatters everything is invisible, what absorbs or scatters once is known.

Each case runs with few samples; the slow ones take a million, whose mean must lie within four of its errors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.media_scenes import GLASS, NULL, colour, fog, lit_ball
from tests.kit.renders import ours

SIZE = 16
FEW, MANY = 128, 4096
"""Samples of each of the 16 x 16 pixels; many are a million together."""
SAMPLES = [FEW, pytest.param(MANY, marks=pytest.mark.slow)]
WITHIN = {FEW: 0.01, MANY: 0.002}
"""The relative error that is allowed to the means of furnaces."""

BOX = T().translate([-1, -1, -1]).scale(2)
TINT = (0.5, 1.0, 2.0)


def grid(values: Any) -> dict[str, Any]:
    """Numbers between -1 and 1 along each axis."""
    return {"type": "gridvolume", "data": np.asarray(values, np.float32), "to_world": BOX}


def rough(*channels: float) -> dict[str, Any]:
    """An uneven extinction."""
    return grid(np.random.default_rng(1).uniform(0, 4, (12, 10, 11, 1)) * np.array(channels))


def mean_and_error(scene: dict[str, Any], spp: int) -> tuple[np.ndarray, np.ndarray]:
    """The mean of each channel and its standard error: all pixels see the same."""
    image = ours(scene, spp=spp, seed=3).reshape(-1, 3)
    return image.mean(axis=0), image.std(axis=0, ddof=1) / SIZE


def require(scene: dict[str, Any], spp: int, expected: Any) -> None:
    """Fail unless the means lie within four errors of what is `expected`."""
    mean, error = mean_and_error(scene, spp)
    # Rays begin 1e-4 beyond a surface.
    assert (np.abs(mean - expected) < 4 * error + 2e-4 * np.abs(expected)).all(), (mean, expected, error)
    assert (error < 0.1 * np.abs(expected)).all()


# ---------------------------------------------------------------- furnaces

FURNACES: dict[str, dict[str, Any]] = {
    "homogeneous": fog(3.0, 1.0),
    "forward": fog(3.0, 1.0, phase={"type": "hg", "g": 0.9}),
    "coloured": fog(colour(1, 2, 4), 1.0),
    "grid": {"type": "heterogeneous", "sigma_t": rough(1), "albedo": 1.0},
    "coloured grid": {"type": "heterogeneous", "sigma_t": rough(*TINT), "albedo": 1.0},
}


BOUNDARIES = {"null": NULL, "glass": GLASS}
QUICK = (("homogeneous", "null"), ("coloured", "glass"), ("grid", "glass"), ("coloured grid", "null"))
CASES = [(*case, FEW) for case in QUICK] + [
    pytest.param(name, boundary, MANY, marks=pytest.mark.slow) for name in FURNACES for boundary in BOUNDARIES
]


@pytest.mark.parametrize(("name", "boundary", "spp"), CASES)
@pytest.mark.sparse(2)
def test_furnace(name: str, boundary: str, spp: int) -> None:
    """A ball that absorbs nothing can't be seen under a white sky."""
    scene = lit_ball(FURNACES[name], BOUNDARIES[boundary], "volpathmis", rr_depth=1000, size=SIZE)
    # The ball covers the picture.
    scene["sensor"]["fov"] = 20
    # Channels that share collisions are noisier than 0.2 % after a million.
    samples = 4 * spp if name == "coloured grid" and spp == MANY else spp
    mean = ours(scene, spp=samples, seed=3).mean(axis=(0, 1))
    assert np.abs(mean - 1).max() < WITHIN[spp]


# ---------------------------------------------------------------- absorption


@pytest.mark.parametrize("spp", SAMPLES)
@pytest.mark.parametrize("integrator", ["volpath", "volpathmis"])
@pytest.mark.parametrize("kind", ["homogeneous", "grid"])
@pytest.mark.sparse(2)
def test_an_absorbing_ball(kind: str, integrator: str, spp: int) -> None:
    """exp(-2 sigma_t) along a diameter, by chance: light that is scattered is lost."""
    sigma = np.array([0.3, 0.6, 1.1])
    medium = fog(colour(*sigma), 0.0)
    if kind == "grid":
        # The mean of each line of the grid is sigma.
        wave = 1 + np.array([0.5, -0.5, -0.9, 0.9] * 2).reshape(8, 1, 1, 1)
        medium = {"type": "heterogeneous", "sigma_t": grid(wave * sigma), "albedo": 0.0}
    scene = lit_ball(medium, integrator=integrator, size=SIZE)
    scene["sensor"]["fov"] = 0.01
    require(scene, spp, np.exp(-2 * sigma))


# ---------------------------------------------------------------- single scattering


def beam(medium: dict[str, Any], shape: dict[str, Any], eye: tuple[float, float, float]) -> dict[str, Any]:
    """A body in a beam of light that runs along -z with irradiance 1, seen from `eye`; scattered at most once."""
    scene = lit_ball(None, max_depth=2, size=SIZE)
    del scene["sky"], scene["ball"]
    up = [0, 1, 0]
    scene["sensor"].update(fov=0.01, to_world=T().look_at(origin=list(eye), target=[0, 0, 0], up=up))
    scene["sun"] = {"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0}
    scene["body"] = {**shape, "bsdf": NULL, "interior": medium}
    return scene


def henyey_greenstein(g: float, cosine: float) -> float:
    """The density of turning by an angle."""
    return float((1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * cosine) ** 1.5))


SLAB = {"type": "cube", "to_world": T().scale([50, 50, 1])}


@pytest.mark.parametrize("spp", SAMPLES)
@pytest.mark.parametrize("tilt", [0.0, 50.0])
@pytest.mark.parametrize("g", [0.0, 0.5])
def test_a_slab_that_scatters_back(tilt: float, g: float, spp: int) -> None:
    """L = albedo p(cos) / (1 + mu) (1 - exp(-tau (1 + 1 / mu))) from a slab in perpendicular light."""
    mu, sigma = np.cos(np.radians(tilt)), np.array([0.2, 0.5, 1.5])
    medium = fog(colour(*sigma), 0.6, phase={"type": "hg", "g": g})
    scene = beam(medium, SLAB, (4 * np.sin(np.radians(tilt)), 0.0, 4 * mu))
    phase = henyey_greenstein(g, -mu)
    require(scene, spp, 0.6 * phase / (1 + mu) * (1 - np.exp(-2 * sigma * (1 + 1 / mu))))


@pytest.mark.parametrize("spp", SAMPLES)
def test_an_uneven_slab(spp: int) -> None:
    """As an even one of the same depth: seen along the beam, both lose the same."""
    depths = np.linspace(0, 1.6, 8).reshape(8, 1, 1)
    place = T().translate([-50, -50, -1]).scale([100, 100, 2])
    medium = {
        "type": "heterogeneous",
        "sigma_t": {**grid(depths), "to_world": place},
        "albedo": 0.6,
        "phase": {"type": "hg", "g": 0.5},
    }
    phase = henyey_greenstein(0.5, -1)
    scene = beam(medium, {"type": "cube", "to_world": T().scale([50.5, 50.5, 1.01])}, (0, 0, 4))
    require(scene, spp, np.full(3, 0.6 * phase / 2 * (1 - np.exp(-2 * 2 * 0.8))))


@pytest.mark.parametrize("spp", SAMPLES)
@pytest.mark.parametrize("kind", ["homogeneous", "heterogeneous"])
def test_a_ball_seen_from_the_side(kind: str, spp: int) -> None:
    """Light comes down through the ball to each point of the diameter that is seen."""
    sigma, albedo = 0.9, 0.7
    medium: dict[str, Any] = {"type": kind, "sigma_t": sigma, "albedo": albedo}
    if kind == "heterogeneous":
        medium["sigma_t"] = grid(np.full((2, 2, 2), sigma))
    x = (np.arange(4000) + 0.5) / 2000 - 1
    inner = sigma * np.exp(-sigma * (1 - x) - sigma * np.sqrt(1 - x**2))
    expected = albedo / (4 * np.pi) * inner.sum() / 2000
    require(beam(medium, {"type": "sphere"}, (4, 0, 0)), spp, np.full(3, expected))
