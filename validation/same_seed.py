"""The comparison of images with the same seed, the most sensitive test: both renderers use the same random numbers.

djpt seeds and draws as Mitsuba's `independent` sampler does, so both follow the same paths and
pixels agree to float rounding, except where rounding changes a decision (an edge, a roulette, a lobe).
A wrong term shows in nearly every pixel that it touches, at any number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from djpt.validation.metrics import pair

__all__ = ["Agreement", "agreement"]


@dataclass(frozen=True)
class Agreement:
    """The agreement of two images with the same seed.

    * `share`: the share of pixels whose channels all agree to within `tolerance`.
    * `worst`: the largest relative difference of a pixel; `median`: the median over the pixels.
    * `bias`: sum of the differences / sum of the reference. Paths that rounding has changed are as often brighter as
      darker, so a bias far above `(1 - share)` times the noise has another cause than rounding.
    """

    share: float
    tolerance: float
    median: float
    worst: float
    bias: float

    def __str__(self) -> str:
        detail = f"median {self.median:.1e}, worst {self.worst:.1e}"
        return f"{self.share:.4%} of pixels within {self.tolerance:g} ({detail})"


def agreement(image: Any, reference: Any, tolerance: float = 1e-3) -> Agreement:
    """Compare two renders with equal seed and spp, shape (H, W, C).

    A pixel's relative difference is ``max over channels |a - b| / max(|a|, |b|, floor)``. The floor, 1e-3 of the
    reference's mean, prevents large relative differences by rounding in channels that are nearly black.
    """
    a, b = pair(image, reference)
    floor = max(1e-3 * float(np.mean(np.abs(b))), float(np.finfo(np.float32).tiny))
    difference = (np.abs(a - b) / np.maximum(np.maximum(np.abs(a), np.abs(b)), floor)).max(axis=2)
    total = float(np.sum(b))
    return Agreement(
        share=float(np.mean(difference <= tolerance)),
        tolerance=tolerance,
        median=float(np.median(difference)),
        worst=float(difference.max()),
        bias=float(np.sum(a - b)) / total if total else 0.0,
    )
