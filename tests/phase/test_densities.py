"""Phase functions: samples follow their density, which adds up to 1; weights; the areas of flakes."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.warp import square_to_uniform_sphere
from djpt.jit.types import Float, Point2f, Vector3f
from djpt.mitsuba.chi2 import ChiSquareTest, PhaseFunctionAdapter, SphericalDomain
from tests.kit.arrays import floats, in_numpy
from tests.kit.phases import FLAKES, PHASES, described, directions, interaction

CTX = djpt.PhaseFunctionContext()
TILTED = [2 / 3, -1 / 3, 2 / 3]
LEVEL = 1e-4
"""Of each test: with some twenty of them, one false alarm in five hundred changes of the random numbers."""


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", PHASES)
def test_samples_follow_the_density(name: str) -> None:
    functions = PhaseFunctionAdapter(PHASES[name]["type"], described(name), TILTED)
    test = ChiSquareTest(SphericalDomain(), *functions, sample_dim=3, sample_count=300_000, res=51, ires=8)
    assert test.run(significance_level=LEVEL, quiet=True), test.messages


def test_the_test_notices_a_wrong_density() -> None:
    """Flakes whose matrix is turned the wrong way about would be found out."""
    samples, _ = PhaseFunctionAdapter("sggx", described("skewed"), TILTED)
    _, density = PhaseFunctionAdapter("sggx", described("skewed"), [-2 / 3, 1 / 3, 2 / 3])
    test = ChiSquareTest(SphericalDomain(), samples, density, sample_dim=3, sample_count=300_000, res=51, ires=8)
    assert not test.run(significance_level=LEVEL, quiet=True)


def stratified(side: int) -> Any:
    """Directions on a fine grid of the sphere."""
    y, x = np.mgrid[:side, :side]
    return square_to_uniform_sphere(Point2f(floats((x + 0.5) / side), floats((y + 0.5) / side)))


@pytest.mark.parametrize("name", PHASES)
def test_densities_add_up_to_one(name: str) -> None:
    phase = djpt.load_dict(described(name))
    value, pdf = phase.eval_pdf(CTX, interaction(djpt, TILTED), stratified(1024))
    total = 4 * np.pi * np.array([dr.mean(value.x)[0], dr.mean(value.y)[0], dr.mean(value.z)[0]])
    np.testing.assert_allclose(total, 1, atol=1e-3)
    np.testing.assert_allclose(4 * np.pi * dr.mean(pdf)[0], 1, atol=1e-3)


@pytest.mark.parametrize("name", PHASES)
def test_sampling_gives_value_over_density(name: str) -> None:
    phase = djpt.load_dict(described(name))
    u = np.random.default_rng(2).random((3, 256), dtype=np.float32)
    mei = interaction(djpt, directions(256, 5))
    wo, weight, pdf = phase.sample(CTX, mei, floats(u[0]), Point2f(floats(u[1]), floats(u[2])))
    value, density = phase.eval_pdf(CTX, mei, wo)
    np.testing.assert_allclose(in_numpy(pdf), in_numpy(density), rtol=3e-3)
    np.testing.assert_allclose(in_numpy(weight * density), in_numpy(value), rtol=1e-4)
    np.testing.assert_allclose(in_numpy(dr.norm(wo)), 1, atol=1e-5)


def test_henyey_greensteins_parameter_is_the_mean_cosine() -> None:
    wo = stratified(512)
    for g in (-0.7, 0.0, 0.3, 0.8):
        mei = interaction(djpt, [0, 0, 1])
        _, pdf = djpt.load_dict({"type": "hg", "g": g}).eval_pdf(CTX, mei, wo)
        assert abs(4 * np.pi * dr.mean(pdf * -wo.z)[0] - g) < 1e-3


@pytest.mark.parametrize("name", FLAKES)
def test_areas_of_flakes(name: str) -> None:
    """The area shown is the mean of the cosines of the flakes that are seen; no direction shows more than the most."""
    phase, mei = djpt.load_dict(described(name)), interaction(djpt, TILTED)
    normals = stratified(512)
    seen = dr.maximum(dr.dot(normals, Vector3f(TILTED)), 0) * djpt.sggx_pdf(normals, FLAKES[name])
    assert abs(4 * np.pi * dr.mean(seen)[0] / phase.projected_area(mei)[0] - 1) < 2e-3
    areas = phase.projected_area(interaction(djpt, stratified(128)))
    most = phase.max_projected_area()[0]
    assert 0.99 * most < dr.max(areas)[0] <= most * (1 + 1e-6)
    assert djpt.load_dict({"type": "rayleigh"}).projected_area(mei) == Float(1)
