"""Measures of images: against closed forms, definitions written out, and each other."""

from __future__ import annotations

import math

import numpy as np
import pytest

from djpt.validation import ComparisonError, flip, hdr_flip, mae, psnr, relative_mse, relative_rmse, ssim
from djpt.validation.metrics import LIMITS, MEASURES, checked_limits, displayed, flip_map, within


def noisy(seed: int = 0, size: tuple[int, int, int] = (24, 20, 3)) -> np.ndarray:
    return np.random.default_rng(seed).random(size)


def test_simple_measures() -> None:
    a, b = np.full((2, 2, 1), 3.0), np.full((2, 2, 1), 1.0)
    b[0, 0] = 3
    assert mae(a, b) == pytest.approx(1.5)
    assert psnr(a, b, peak=4) == pytest.approx(20 * math.log10(4 / math.sqrt(3)))
    assert psnr(a, a) == math.inf
    assert relative_mse(a, b) == pytest.approx(relative_rmse(a, b) ** 2) == pytest.approx(3 * 4 / 1.01 / 4)


def test_ssim_of_flat_images() -> None:
    """Without structure only the means count: equation 6 of the paper, 2ab + C1 over a^2 + b^2 + C1."""
    a, b = np.full((16, 16, 3), 0.5), np.full((16, 16, 3), 0.25)
    assert ssim(a, b) == pytest.approx((2 * 0.5 * 0.25 + 1e-4) / (0.5**2 + 0.25**2 + 1e-4))
    assert ssim(a, a) == pytest.approx(1)


def test_ssim_of_one_window() -> None:
    """An image of the window's size has one window: the definition, written out."""
    a, b = noisy(1, (11, 11, 1))[..., 0], noisy(2, (11, 11, 1))[..., 0]
    taps = np.exp(-0.5 * ((np.arange(11) - 5) / 1.5) ** 2)
    weights = np.outer(taps, taps) / taps.sum() ** 2
    first, second = (weights * a).sum(), (weights * b).sum()
    spread = (weights * ((a - first) ** 2 + (b - second) ** 2)).sum()
    common = (weights * (a - first) * (b - second)).sum()
    expected = (2 * first * second + 1e-4) * (2 * common + 9e-4)
    expected /= (first**2 + second**2 + 1e-4) * (spread + 9e-4)
    assert ssim(a[..., None], b[..., None]) == pytest.approx(expected)


def test_ssim_falls_with_noise_and_takes_small_images() -> None:
    image = np.linspace(0, 1, 32 * 32).reshape(32, 32, 1)
    found = [ssim(image + amount * noisy(3, image.shape), image) for amount in (0, 0.01, 0.1, 0.5)]
    assert found == sorted(found, reverse=True)
    assert ssim(noisy(0, (1, 3, 2)), noisy(0, (1, 3, 2))) == pytest.approx(1)


def test_flip() -> None:
    pytest.importorskip("flip_evaluator")
    a, b = noisy(0), noisy(1)
    assert flip(a, a) == hdr_flip(a, a) == 0
    assert 0 < flip(a, b) <= 1 and 0 < hdr_flip(a, b) <= 1
    assert flip_map(a, b).shape == (24, 20)
    assert flip(a, b) == pytest.approx(float(flip_map(a, b).mean()))
    assert flip(a[..., :1], b[..., :1]) > 0
    above = a.copy()
    above[:4] += 2
    clipped = np.minimum(above, 1)
    assert flip(above, clipped) == 0 < hdr_flip(above, clipped), "only HDR-FLIP sees what a display clips"
    with pytest.raises(ComparisonError, match="black"):
        hdr_flip(a, np.zeros_like(a))


def test_displayed() -> None:
    np.testing.assert_allclose(displayed([[[-1.0, 0.0, 0.5, 2.0]]]), [[[0, 0, 0.735357, 1]]], atol=1e-5)


def test_limits() -> None:
    assert checked_limits({"rmse": 1, "flip": None}) == {"rmse": 1.0}
    with pytest.raises(ComparisonError, match=r"unknown threshold 'rsme'.*rmse"):
        checked_limits({"rsme": 1})
    for wrong in (True, "1", math.nan):
        with pytest.raises(ComparisonError, match="must be a number"):
            checked_limits({"flip": wrong})  # type: ignore[dict-item]
    assert set(MEASURES) < set(LIMITS)
    assert within("psnr", 31, 30) and not within("psnr", 29, 30)
    assert within("same_seed", 1, 0.9) and not within("same_seed", 0.8, 0.9)
    assert within("bias", -0.01, 0.02) and not within("bias", -0.03, 0.02)
    assert not within("rmse", math.nan, 1)
