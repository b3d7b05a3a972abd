"""Points of the unit square where a bitmap is bright, as lights draw them."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.distributions import DiscreteDistribution2D
from djpt.jit.types import Float, Point2f
from djpt.textures.bitmap import Bitmap
from tests.kit.chi_squared import SIGNIFICANCE, probability_of_counts, uniform
from tests.kit.one_light import TURNED, bitmap, reference

COUNT = 2**16
BITMAPS = {
    f"{kind} {wrap}": {"filter_type": kind, "wrap_mode": wrap}
    for kind, wrap in itertools.product(("bilinear", "nearest"), ("repeat", "mirror", "clamp"))
}
MAPPED = {"flipped": {"to_uv": T().translate([0, 1, 0]).scale([1, -1, 1])}, "turned": {"to_uv": TURNED}}


def prepared(**keys: Any) -> Bitmap:
    """A bitmap texture as a light has it."""
    texture = djpt.load_dict(bitmap(**keys))
    texture.prepare_sampling()
    return texture


@pytest.mark.sparse(4)
@pytest.mark.parametrize("keys", BITMAPS.values(), ids=BITMAPS)
@pytest.mark.parametrize("shape", [(5, 7, 3), (1, 1, 3), (9, 1, 1), (17, 40, 1)], ids=str)
def test_points_are_mitsubas(shape: tuple[int, ...], keys: dict[str, Any]) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    texels = np.random.default_rng(1).random(shape, dtype=np.float32)
    if texels.size > 3:
        texels[0, 0] = texels[-1, -1] = 0
    mine = prepared(texels=texels, **keys)
    other = mi.load_dict(bitmap(texels, **keys))
    sample, place = uniform(20000), uniform(20000, seed=1)
    uv, pdf = mine.sample_position(Point2f(*sample))
    expected, density = other.sample_position(mi.Point2f(*sample))
    np.testing.assert_allclose(np.array(uv), np.array(expected), atol=5e-5)
    np.testing.assert_allclose(np.array(pdf), np.array(density), rtol=1e-3, atol=1e-3)
    there = np.array(other.pdf_position(mi.Point2f(*place)))
    np.testing.assert_allclose(np.array(mine.pdf_position(Point2f(*place))), there, atol=2e-5)


@pytest.mark.parametrize("keys", [*BITMAPS.values(), *MAPPED.values()], ids=[*BITMAPS, *MAPPED])
def test_points_follow_the_density(keys: dict[str, Any]) -> None:
    texture = prepared(**keys)
    uv, pdf = texture.sample_position(Point2f(*uniform(COUNT)))
    np.testing.assert_allclose(np.array(pdf), np.array(texture.pdf_position(uv)), rtol=1e-6)
    bins, fine = (21, 20), 32
    observed = np.histogram2d(*np.array(uv, np.float64), bins, [(0, 1), (0, 1)])[0]
    assert observed.sum() == COUNT
    v, u = np.meshgrid(*((np.arange(n * fine) + 0.5) / (n * fine) for n in bins[::-1]))
    place = Point2f(*(Float(x.T.ravel().astype(np.float32)) for x in (u.T, v.T)))
    grid = np.array(texture.pdf_position(place), np.float64).reshape(bins[0], fine, bins[1], fine)
    expected = grid.mean(axis=(1, 3)) / np.prod(bins)
    assert expected.sum() == pytest.approx(1, rel=2e-3)
    # The quadrature errs where a cell ends within a bin.
    assert probability_of_counts(observed, expected, error=3e-3) > SIGNIFICANCE


@pytest.mark.parametrize("keys", [*BITMAPS.values(), *MAPPED.values()], ids=[*BITMAPS, *MAPPED])
def test_density_is_positive_where_there_is_light(keys: dict[str, Any]) -> None:
    """Or gradients and light would be lost; and is near the radiance's shape."""
    texture = prepared(**keys)
    si = reference()
    si.uv = Point2f(*uniform(COUNT))
    value, pdf = np.array(texture.eval_1(si), np.float64), np.array(texture.pdf_position(si.uv), np.float64)
    assert (pdf[value > 0] > 0).all()
    relative = value / float(texture.mean()[0])
    spread = np.sqrt(((relative - pdf) ** 2).mean()) / relative.std()
    assert spread < (0.6 if "to_uv" in keys else 1e-3 if keys["filter_type"] == "nearest" else 0.02)


def test_choice_of_cells_at_the_ends() -> None:
    """Cells of weight 0 are never chosen, nor is anything beyond the grid."""
    weights = np.zeros((4, 5))
    weights[1, 1:3] = 1, 3
    weights[2, 3] = 2
    grid = DiscreteDistribution2D("grid", weights)
    ends = [0.0, 1e-30, 2**-24, 0.5, 1 - 2**-24]
    sample = Point2f(*(Float(list(x)) for x in zip(*itertools.product(ends, ends), strict=True)))
    column, row, rest = grid.sample(sample)
    assert (weights[np.array(row), np.array(column)] > 0).all()
    assert (np.array(grid.density(column, row)) > 0).all()
    left = np.array(rest)
    assert left.min() >= 0
    assert left.max() <= 1


def test_a_dark_grid_is_sampled_uniformly() -> None:
    grid = DiscreteDistribution2D("grid", np.zeros((3, 4)))
    column, row, _ = grid.sample(Point2f(*uniform(24000)))
    counts = np.histogram2d(np.array(row), np.array(column), (3, 4))[0]
    np.testing.assert_allclose(counts, 2000, atol=250)
    np.testing.assert_array_equal(np.array(grid.density(column, row)), 1)
