"""The measures of a comparison by name, each of which can be a threshold."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from djpt.errors import near_miss
from djpt.validation import metrics, perceptual
from djpt.validation.metrics import ComparisonError

__all__ = ["LIMITS", "MEASURES", "Measure", "checked_limits", "within"]


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
    return lambda image, reference: compute(perceptual.displayed(image), perceptual.displayed(reference))


MEASURES: Mapping[str, Measure] = {
    "rmse": Measure("RMSE", metrics.rmse),
    "mae": Measure("MAE", metrics.mae),
    "relmse": Measure("relMSE", metrics.relative_mse),
    "bias": Measure("relative mean bias", metrics.relative_bias),
    "psnr": Measure("PSNR, displayed", as_displayed(metrics.psnr), "greater"),
    "ssim": Measure("SSIM, displayed", as_displayed(perceptual.ssim), "greater"),
    "flip": Measure("FLIP", perceptual.flip),
    "hdr_flip": Measure("HDR-FLIP", perceptual.hdr_flip),
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
