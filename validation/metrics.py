"""Measures of the difference of two images: plain numbers, without a test whether noise explains them.

Every function takes two arrays of equal shape (H, W, C), compares `image` with `reference` and computes in
float64. Such a test needs variances: see `djpt.validation.statistics`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.errors import BackendError, DjptError, near_miss
from djpt.images.srgb import encoded

__all__ = [
    "LIMITS",
    "MEASURES",
    "ComparisonError",
    "Measure",
    "checked_limits",
    "displayed",
    "flip",
    "flip_map",
    "hdr_flip",
    "hdr_flip_map",
    "mae",
    "mean_bias",
    "pair",
    "psnr",
    "relative_bias",
    "relative_mse",
    "relative_rmse",
    "rmse",
    "ssim",
    "within",
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


# ---- measures that follow the eye: SSIM and FLIP ---------------------------------------------


WINDOW = 11
"""The side of SSIM's window in pixels, and `SPREAD` its standard deviation, as Wang et al. chose them."""
SPREAD = 1.5
STABILIZERS = (0.01**2, 0.03**2)
"""The constants C1 and C2 that keep SSIM's quotients finite in dark and in flat windows, for values up to 1."""


def displayed(image: Any) -> Array:
    """Linear values as a display shows them: clipped to [0, 1] and encoded in sRGB, (H, W, C)."""
    return encoded(np.clip(np.asarray(image, np.float64), 0, 1))


def ssim(image: Any, reference: Any) -> float:
    """The mean structural similarity: 1 for equal images, around 0 for unrelated ones.

    Both images are compared as they come; `displayed` makes them what a viewer sees. Each channel is compared by
    itself in all windows that lie inside the image, and the mean is taken over windows and channels. The window is
    a Gaussian of 11 x 11 pixels, smaller in images that are.

    Source: Z. Wang, A. Bovik, H. Sheikh, E. Simoncelli, *Image quality assessment: from error visibility to
    structural similarity*, IEEE Transactions on Image Processing 13(4), 2004, equations 6 and 13.
    """
    a, b = pair(image, reference)
    first, second = smoothed(a), smoothed(b)
    variances = smoothed(a * a) - first**2 + smoothed(b * b) - second**2
    covariance = smoothed(a * b) - first * second
    c1, c2 = STABILIZERS
    likeness = (2 * first * second + c1) * (2 * covariance + c2)
    return float(np.mean(likeness / ((first**2 + second**2 + c1) * (variances + c2))))


def smoothed(image: Array) -> Array:
    """The Gaussian means of all windows that lie inside the image, (rows, columns, C)."""
    for axis in range(2):
        size = min(WINDOW, image.shape[axis])
        taps = np.exp(-0.5 * ((np.arange(size) - (size - 1) / 2) / SPREAD) ** 2)
        windows = np.lib.stride_tricks.sliding_window_view(image, size, axis=axis)
        image = windows @ (taps / taps.sum())
    return image


def flip(image: Any, reference: Any) -> float:
    """The mean of `flip_map`: 0 for equal images, at most 1."""
    return float(np.mean(flip_map(image, reference)))


def hdr_flip(image: Any, reference: Any) -> float:
    """The mean of `hdr_flip_map`: 0 for equal images, at most 1."""
    return float(np.mean(hdr_flip_map(image, reference)))


def flip_map(image: Any, reference: Any) -> Array:
    """FLIP per pixel, (H, W) in [0, 1]: the difference seen when the two images take turns on a display.

    Both images are linear; they are clipped and encoded as `displayed` does. The display is FLIP's own: 67 pixels
    per degree. Source: P. Andersson et al., *FLIP: a difference evaluator for alternating images*, HPG 2020; computed
    by the package ``flip-evaluator``. Raises `BackendError` without it.
    """
    a, b = (colours(values) for values in pair(image, reference))
    return evaluated(displayed(a), displayed(b), "LDR")


def hdr_flip_map(image: Any, reference: Any) -> Array:
    """HDR-FLIP per pixel, (H, W) in [0, 1]: the largest FLIP over a range of exposures.

    Both images are linear; negative values count as 0. The range of exposures follows from the reference. Source:
    P. Andersson et al., *Visualizing errors in rendered high dynamic range images*, Eurographics 2021 (short papers);
    computed by the package ``flip-evaluator``. Raises `BackendError` without it.
    """
    a, b = (np.maximum(colours(values), 0) for values in pair(image, reference))
    if not b.max() > 0:
        raise ComparisonError("HDR-FLIP finds its exposures from the reference, which is black")
    return evaluated(a, b, "HDR")


def evaluated(image: Array, reference: Array, kind: str) -> Array:
    """The map of the package, (H, W)."""
    try:
        import flip_evaluator
    except ImportError:
        raise BackendError("FLIP needs the package flip-evaluator: pip install flip-evaluator") from None
    found, _, _ = flip_evaluator.evaluate(
        reference.astype(np.float32), image.astype(np.float32), kind, applyMagma=False, computeMeanError=False
    )
    return np.asarray(found, np.float64).reshape(image.shape[:2])


def colours(image: Array) -> Array:
    """The red, green and blue of an image (H, W, C), three times grey if it has less than three channels."""
    return image[..., :3] if image.shape[2] >= 3 else image[..., :1].repeat(3, axis=2)


# ---- measures by name, each of which can be a threshold --------------------------------------


@dataclass(frozen=True)
class Measure:
    """One number that says how far two images are apart.

    * `title`: what tables call it.
    * `compute`: the number, from an image and a reference, both linear (H, W, C).
    * `closer`: whether a ``"less"`` or a ``"greater"`` number means that the images are closer.
    """

    title: str
    compute: Callable[[Any, Any], float]
    closer: str = "less"


def as_displayed(compute: Callable[[Any, Any], float]) -> Callable[[Any, Any], float]:
    """The measure of two images as a display shows them."""
    return lambda image, reference: compute(displayed(image), displayed(reference))


MEASURES: Mapping[str, Measure] = {
    "rmse": Measure("RMSE", rmse),
    "mae": Measure("MAE", mae),
    "relmse": Measure("relMSE", relative_mse),
    "bias": Measure("relative mean bias", relative_bias),
    "psnr": Measure("PSNR, displayed", as_displayed(psnr), "greater"),
    "ssim": Measure("SSIM, displayed", as_displayed(ssim), "greater"),
    "flip": Measure("FLIP", flip),
    "hdr_flip": Measure("HDR-FLIP", hdr_flip),
}
"""Measures of two images. PSNR, SSIM and FLIP are those of clipped sRGB in [0, 1], the others of linear light."""

LIMITS = (*MEASURES, "z", "same_seed")
"""The names of thresholds: the measures; ``z``, the mean bias in units of its standard error; ``same_seed``, the share
of pixels that agree."""


def checked_limits(limits: Mapping[str, float | None]) -> dict[str, float]:
    """The thresholds that are set. Raises `ComparisonError` for unknown names and for what isn't a number."""
    found: dict[str, float] = {}
    for name, value in limits.items():
        if name not in LIMITS:
            raise ComparisonError(f"compare: unknown threshold '{name}'{near_miss(name, LIMITS)}")
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, (int, float)) or math.isnan(value):
            raise ComparisonError(f"compare: the threshold '{name}' must be a number, found {value!r}")
        found[name] = float(value)
    return found


def within(name: str, value: float, limit: float) -> bool:
    """True if a value meets its threshold: NaN never does."""
    if name == "same_seed" or (name in MEASURES and MEASURES[name].closer == "greater"):
        return value >= limit
    return abs(value) <= limit
