"""Measures that follow the eye: SSIM and FLIP.

Every function takes two arrays of equal shape (H, W, C). Of images with 2 or more than 3 channels, only the first
(grey) or the first three (red, green, blue) are compared.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.errors import BackendError
from djpt.images.srgb import encoded
from djpt.validation.metrics import ComparisonError, pair

__all__ = ["displayed", "flip", "flip_map", "hdr_flip", "hdr_flip_map", "ssim"]

Array = npt.NDArray[np.float64]

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
