"""Measures of the difference of two images: plain numbers, without a test whether noise explains them.

Every function takes two arrays of equal shape (H, W, C), compares `image` with `reference` and computes in
float64. Such a test needs variances: see `djpt.validation.statistics`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.errors import DjptError

__all__ = [
    "ComparisonError",
    "mae",
    "mean_bias",
    "pair",
    "psnr",
    "relative_bias",
    "relative_mse",
    "relative_rmse",
    "rmse",
]

Array = npt.NDArray[np.float64]


class ComparisonError(DjptError, AssertionError):
    """Two images can't be compared, or `assert_matches` found that they differ."""


def rmse(image: Any, reference: Any) -> float:
    """The root mean square error sqrt(mean((a - b)^2)) over pixels and channels."""
    a, b = pair(image, reference)
    return float(np.sqrt(np.mean(np.square(a - b))))


def mae(image: Any, reference: Any) -> float:
    """The mean absolute error ``mean(|a - b|)`` over pixels and channels."""
    a, b = pair(image, reference)
    return float(np.mean(np.abs(a - b)))


def psnr(image: Any, reference: Any, peak: float = 1.0) -> float:
    """The peak signal-to-noise ratio 20 log10(peak / rmse) in decibels; infinite for equal images."""
    error = rmse(image, reference)
    return 20 * math.log10(peak / error) if error > 0 else math.inf


def relative_mse(image: Any, reference: Any, epsilon: float = 1e-2) -> float:
    """The relMSE mean((a - b)^2 / (b^2 + epsilon)), the square of `relative_rmse`."""
    return relative_rmse(image, reference, epsilon) ** 2


def relative_rmse(image: Any, reference: Any, epsilon: float = 1e-2) -> float:
    """The square root of relMSE, sqrt(mean((a - b)^2 / (b^2 + epsilon))).

    `epsilon` (default 0.01) keeps black pixels from dominating; it is the usual value in papers on
    denoising and sampling (Rousselle et al. 2011, *Adaptive sampling and reconstruction using
    greedy error minimization*).
    """
    a, b = pair(image, reference)
    return float(np.sqrt(np.mean(np.square(a - b) / (np.square(b) + epsilon))))


def mean_bias(image: Any, reference: Any) -> float:
    """The bias mean(a - b) over pixels and channels: positive if `image` is too bright."""
    a, b = pair(image, reference)
    return float(np.mean(a - b))


def relative_bias(image: Any, reference: Any) -> float:
    """The ratio of `mean_bias` to the reference's mean; 0 if both are 0."""
    bias, level = mean_bias(image, reference), abs(float(np.mean(np.asarray(reference, np.float64))))
    if level == 0:
        return math.copysign(math.inf, bias) if bias else 0.0
    return bias / level


def pair(image: Any, reference: Any) -> tuple[Array, Array]:
    """Convert both images to float64; raise `ComparisonError` unless shapes agree and all values are finite."""
    a, b = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    if a.shape != b.shape or a.ndim != 3 or a.size == 0:
        raise ComparisonError(f"images to compare need one shape (H, W, C), found {a.shape} and {b.shape}")
    for name, values in (("image", a), ("reference", b)):
        bad = int(np.count_nonzero(~np.isfinite(values)))
        if bad:
            raise ComparisonError(f"the {name} has {bad} values that are NaN or infinite")
    return a, b
