"""Pearson's test as scripts use it: it accepts what is right, as Mitsuba's does, and rejects what is wrong."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import ArgumentError, DjptError
from djpt.mitsuba.chi2 import (
    ChiSquareTest,
    LineDomain,
    MicrofacetAdapter,
    PlanarDomain,
    SpectrumAdapter,
    SphericalDomain,
)

FEW: dict[str, Any] = {"sample_count": 100_000, "res": 31, "ires": 8}


def test_histogram_and_verdict_are_mitsubas(mi: Any) -> None:
    def run(m: Any) -> Any:
        warp = m.warp
        test = m.chi2.ChiSquareTest(
            domain=m.chi2.SphericalDomain(),
            sample_func=lambda sample: warp.square_to_von_mises_fisher(sample, 3),
            pdf_func=lambda v: warp.square_to_von_mises_fisher_pdf(v, 3),
            seed=5,
            **FEW,
        )
        assert test.run(quiet=True)
        return test

    ours, theirs = run(djpt), run(mi)
    # The last bits of a sample may decide between two cells.
    difference = np.abs(ours.histogram.numpy() - theirs.histogram.numpy())
    assert difference.sum() <= 10
    np.testing.assert_allclose(ours.pdf.numpy(), theirs.pdf.numpy(), rtol=1e-3)
    assert ours.p_value == pytest.approx(theirs.p_value, abs=0.05)


@pytest.mark.parametrize("name", ["square_to_tent", "square_to_uniform_disk", "square_to_uniform_disk_concentric"])
def test_warps_to_the_plane(name: str) -> None:
    density = getattr(djpt.warp, f"{name}_pdf")
    # Much finer than cells, as the edge of the disk cuts them.
    test = ChiSquareTest(PlanarDomain(), getattr(djpt.warp, name), density, sample_count=20_000, res=15, ires=64)
    assert test.run(quiet=True), test.messages


def test_samples_of_three_numbers() -> None:
    tangent, wi = djpt.Vector3f(0.6, 0, 0.8), djpt.Vector3f(0, 0.6, 0.8)
    test = ChiSquareTest(
        SphericalDomain(),
        lambda sample: djpt.warp.square_to_rough_fiber(sample, wi, tangent, 4),
        lambda v: djpt.warp.square_to_rough_fiber_pdf(v, wi, tangent, 4),
        sample_dim=3,
        **FEW,
    )
    assert test.run(quiet=True), test.messages


def test_numbers_of_a_line() -> None:
    distribution = djpt.IrregularContinuousDistribution([1, 1.5, 1.8, 5], [1, 3, 0, 1])
    test = ChiSquareTest(
        LineDomain((1, 5)),
        lambda sample: djpt.types.backend.Array1f(distribution.sample(sample[0])),
        distribution.eval_pdf_normalized,
        sample_dim=1,
        **FEW,
    )
    assert test.run(quiet=True), test.messages


def test_points_of_a_box() -> None:
    values = np.random.default_rng(0).uniform(0, 1, (5, 4))
    distribution = djpt.Hierarchical2D0(values)
    box = SimpleNamespace(min=[0, 0], max=[1, 1])
    test = ChiSquareTest(PlanarDomain(box), lambda s: distribution.sample(s)[0], distribution.eval, **FEW)
    assert test.run(quiet=True), test.messages


@pytest.mark.parametrize("visible", [True, False])
@pytest.mark.parametrize("name", ["beckmann", "ggx"])
def test_microfacets(name: str, visible: bool) -> None:
    sample, density = MicrofacetAdapter(name, 0.4, visible)
    test = ChiSquareTest(SphericalDomain(), lambda s: sample(s, 40), lambda m: density(m, 40), **FEW)
    assert test.run(quiet=True), test.messages


def test_samples_without_weight_do_not_count() -> None:
    test = ChiSquareTest(
        SphericalDomain(),
        lambda s: (djpt.warp.square_to_uniform_sphere(s), dr.select(s.y < 0.5, djpt.Float(1), 0)),
        lambda v: dr.select(v.z > 0, djpt.warp.square_to_uniform_sphere_pdf(v), 0),
        sample_count=50_000,
        res=30,
        ires=4,
    )
    assert test.run(quiet=True), test.messages
    assert test.histogram_sum == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("sample", "density", "reason"),
    [
        ("square_to_cosine_hemisphere", "square_to_uniform_hemisphere_pdf", "REJECTED"),
        ("square_to_uniform_sphere", "square_to_uniform_hemisphere_pdf", "cells where the density is 0"),
        ("square_to_uniform_sphere", "square_to_uniform_disk_pdf", "adds up to more than 1"),
    ],
)
def test_what_is_wrong_is_rejected(
    sample: str, density: str, reason: str, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def pdf(v: Any) -> Any:
        if "disk" in density:
            return dr.full(djpt.Float, 1 / np.pi, dr.width(v))
        return getattr(djpt.warp, density)(v)

    test = ChiSquareTest(SphericalDomain(), getattr(djpt.warp, sample), pdf, **FEW)
    assert not test.run()
    assert reason in test.messages
    assert test.messages in capsys.readouterr().out


def test_negative_densities_and_samples_elsewhere_are_rejected() -> None:
    test = ChiSquareTest(PlanarDomain(), lambda s: s * 3, lambda p: djpt.Float(-1) + p.x * 0, **FEW)
    assert not test.run(quiet=True)
    assert "outside of the domain" in test.messages and "is negative in a cell" in test.messages


def test_many_tests_share_a_level() -> None:
    """Each of n tests is asked for 1 - (1 - level)^(1 / n)."""
    test = ChiSquareTest(PlanarDomain(), lambda s: 2 * s - 1, lambda p: djpt.Float(0.25) + p.x * 0, **FEW)
    assert test.run(significance_level=0.05, test_count=10, quiet=True)
    assert f"{1 - 0.95**0.1:.6g}" in test.messages


def test_what_is_not_there_says_why() -> None:
    with pytest.raises(DjptError, match="no wavelengths to sample"):
        SpectrumAdapter("<spectrum/>")
    with pytest.raises(ArgumentError, match="'res' must be at least 1"):
        ChiSquareTest(PlanarDomain(), lambda s: s, lambda p: p.x, res=0)
