"""Resampling of arrays, and filters as scripts ask them, beside Mitsuba's."""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import SceneError
from djpt.images.resampler import FilterBoundaryCondition, Resampler
from djpt.jit.types import Float

FILTERS = ("box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos")


@pytest.fixture
def mi() -> Any:
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


@pytest.mark.parametrize("name", FILTERS)
def test_filters_answer_as_mitsubas(mi: Any, name: str) -> None:
    ours, theirs = djpt.load_dict({"type": name}), mi.load_dict({"type": name})
    for question in ("radius", "border_size", "is_box_filter"):
        assert getattr(ours, question)() == getattr(theirs, question)()
    for x in (-0.5, 0.0, 0.3, 0.5, 1.2, 2.6, 9.0):
        assert np.ravel(ours.eval(x))[0] == pytest.approx(theirs.eval(x), abs=3e-5)
        assert np.ravel(ours.eval_discretized(x))[0] == np.ravel(ours.eval(x))[0]
    assert isinstance(ours, djpt.ReconstructionFilter)
    assert djpt.ReconstructionFilter is djpt.BitmapReconstructionFilter


@pytest.mark.sparse(5)
@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("boundary", list(FilterBoundaryCondition))
def test_arrays_are_resampled_as_by_mitsuba(mi: Any, name: str, boundary: FilterBoundaryCondition) -> None:
    for source, target in itertools.product((5, 6, 17), (1, 3, 5, 6, 20)):
        given = np.random.default_rng(source).random(source).astype(np.float32)
        results = []
        for module in (djpt, mi):
            resampler = module.Resampler(module.load_dict({"type": name}), source, target)
            resampler.set_boundary_condition(getattr(module.FilterBoundaryCondition, boundary.name))
            result = np.zeros(target, np.float32)
            resampler.resample(given, 1, result, 1, 1)
            resampler.set_clamp((0.3, 0.6))
            clipped = np.zeros(target, np.float32)
            resampler.resample(given, 1, clipped, 1, 1)
            assert resampler.clamp() == pytest.approx((0.3, 0.6))
            results.append((result, clipped, resampler.taps(), repr(resampler)))
        assert results[0][2:] == results[1][2:]
        for ours, theirs in zip(results[0][:2], results[1][:2], strict=True):
            np.testing.assert_allclose(ours, theirs, atol=2e-6)


@pytest.mark.parametrize("kind", [Float, dr.scalar.ArrayXf])
def test_arrays_of_drjit_receive_results(kind: Any) -> None:
    source, target = dr.linspace(kind, 0, 1, 5), dr.zeros(kind, 3)
    resampler = Resampler(djpt.load_dict({"type": "box"}), 5, 3)
    resampler.resample(source, 1, target, 1, 1)
    assert list(target) == [0.125, 0.5, 0.875]
    assert resampler.boundary_condition() is FilterBoundaryCondition.Clamp
    assert (resampler.source_resolution(), resampler.target_resolution()) == (5, 3)


def test_channels_and_strides() -> None:
    pixels = np.arange(24, dtype=np.float32).reshape(6, 2, 2)
    result = np.full((3, 1, 2), -1, np.float32)
    Resampler(djpt.load_dict({"type": "box"}), 6, 3).resample(pixels, 2, result, 1, 2)
    np.testing.assert_allclose(result[:, 0], (pixels[::2, 0] + pixels[1::2, 0]) / 2)


def test_errors() -> None:
    box = djpt.load_dict({"type": "box"})
    with pytest.raises(SceneError, match="needs at least one sample, found 0 to be made 3"):
        Resampler(box, 0, 3)
    with pytest.raises(SceneError, match="'target' needs 3 x 1 x 1 numbers, found 4"):
        Resampler(box, 5, 3).resample(np.zeros(5, np.float32), 1, np.zeros(4, np.float32), 1, 1)
    with pytest.raises(SceneError, match="the filter is too narrow to make 40 samples of 20"):
        Resampler(djpt.load_dict({"type": "tent", "radius": 0.1}), 20, 40)
