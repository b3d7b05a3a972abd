"""The result of a comparison: numbers, tests, a verdict, a picture and a page."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.images.sheets import DARK, Tile, captioned_sheet, enlarged, shown
from djpt.validation.metrics import MEASURES, flip_map, pair, within
from djpt.validation.report import Bytes, Pictured, aligned, difference_picture
from djpt.validation.statistics import TestResult

__all__ = ["Agreement", "Comparison", "agreement"]


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


# ---- the result ------------------------------------------------------------------------------


ALWAYS = ("mae", "relmse", "psnr", "ssim")
"""The measures of every table, beside RMSE and the bias. FLIP takes longer and is shown where it is a threshold."""


@dataclass(frozen=True)
class Comparison(Pictured):
    """The result of `compare`. `print()` shows a table, `write_picture(path)` a picture, `write_page(path)` a page.

    * `image`, `reference`: the mean images of the two sides, (H, W, C) float32, linear.
    * `titles`: what the two sides are called: djpt and Mitsuba, or others.
    * `spp`, `reference_spp`, `batch_spp`: samples per pixel in all, and of one batch; 0 for images from files.
    * `rmse`, `relative_rmse`, `bias` (mean of the difference), `relative_bias`: see `djpt.validation.metrics`.
    * `noise_rmse`: the RMSE that noise alone is expected to cause: the root of the sum of both mean variances.
    * `noise_ratio`: standard deviation of our pixels / the reference's at equal spp, geometric mean over pixels.
      It and `noise_rmse` are NaN for images whose noise isn't known.
    * `tests`: the families of `djpt.validation.statistics`: image mean, weighted mean, blocks, pixels;
      none without noise.
    * `z_map`: the deviate of each pixel's worst channel, (H, W), or None without noise.
    * `same_seed`: agreement of one pair of renders with the same seed at `same_seed_spp`, or None.
    * `seconds`, `reference_seconds`: median time of one batch, without the first one, which compiles.
    * `limits`: the thresholds that were given, by the names of `djpt.validation.metrics.LIMITS`.
    * `facts`: for each side, what was rendered: names and values for people to read.
    """

    title = "a comparison"

    name: str
    image: npt.NDArray[np.float32]
    reference: npt.NDArray[np.float32]
    spp: int
    reference_spp: int
    batch_spp: int
    rmse: float
    noise_rmse: float
    relative_rmse: float
    bias: float
    relative_bias: float
    noise_ratio: float
    tests: tuple[TestResult, ...]
    same_seed: Agreement | None
    same_seed_spp: int
    seconds: float
    reference_seconds: float
    limits: Mapping[str, float] = field(default_factory=dict)
    titles: tuple[str, str] = ("djpt", "Mitsuba")
    z_map: npt.NDArray[np.float64] | None = None
    facts: tuple[Mapping[str, Any], Mapping[str, Any]] = field(default_factory=lambda: ({}, {}))

    def measure(self, name: str) -> float:
        """One of `djpt.validation.metrics.MEASURES`, computed when it is first asked for."""
        if name not in self._measured:
            self._measured[name] = MEASURES[name].compute(self.image, self.reference)
        return self._measured[name]

    @cached_property
    def _measured(self) -> dict[str, float]:
        return {"rmse": self.rmse, "bias": self.relative_bias}

    @cached_property
    def flip_map(self) -> npt.NDArray[np.float64]:
        """FLIP per pixel, (H, W); see `djpt.validation.metrics.flip_map`."""
        found = flip_map(self.image, self.reference)
        self._measured["flip"] = float(np.mean(found))
        return found

    @property
    def failures(self) -> list[str]:
        """One line for each check that failed; empty if all passed."""
        found = [str(test) for test in self.tests if not test.passed]
        for name, limit in self.limits.items():
            if name in MEASURES and not within(name, self.measure(name), limit):
                side = "above" if MEASURES[name].closer == "less" else "below"
                noise = f" (noise alone: {self.noise_rmse:.4g})" if name == "rmse" and self.noise_rmse > 0 else ""
                found.append(f"{MEASURES[name].title} {self.measure(name):.4g} {side} {limit:g}{noise}")
        if "same_seed" in self.limits and self.same_seed and not self.same_seed.share >= self.limits["same_seed"]:
            found.append(f"same seed: {self.same_seed}, at least {self.limits['same_seed']:.4%} expected")
        return found

    @property
    def checks(self) -> int:
        """The number of tests and thresholds: without any, passing says nothing."""
        return len(self.tests) + len(set(self.limits) - {"z"})

    @property
    def passed(self) -> bool:
        """True if all tests and all given thresholds hold."""
        return not self.failures

    @property
    def verdict(self) -> str:
        """``passed``, ``FAILED``, or that there was nothing to decide by."""
        if not self.checks:
            return "compared, without thresholds"
        return "passed" if self.passed else "FAILED"

    @property
    def speed(self) -> float:
        """The reference's time / ours for one batch: an estimate, which `benchmarks/` measures more precisely."""
        return self.reference_seconds / self.seconds if self.seconds > 0 else math.inf

    def write_page(self, path: str | os.PathLike[str]) -> None:
        """Write a page for a browser, one HTML file that needs no network: both images, differences, all numbers."""
        from djpt.validation.page import write_page

        write_page(self, path)

    def picture(self) -> Bytes:
        """Three panels with captions: image | reference | difference, sRGB (H, W, 3).

        The third panel shows the mean over the channels of ours - Mitsuba's: red where ours is brighter, blue where it
        is darker. Its full scale, stated below it, is exceeded by one pixel in a hundred.
        """
        difference = np.abs(np.mean(self.image.astype(np.float64) - self.reference, axis=2))
        scale = max(float(np.quantile(difference, 0.99)), 1e-6)
        ours, theirs = shown(self.image), shown(self.reference)
        first, second = (
            f"{title}, {spp} spp" if spp else title
            for title, spp in zip(self.titles, (self.spp, self.reference_spp), strict=True)
        )
        tiles = [
            Tile(first, f"mean {np.mean(self.image):.5g}", ours),
            Tile(second, f"mean {np.mean(self.reference):.5g}", theirs),
            Tile(
                f"difference, RMSE {self.rmse:.3g}",
                f"red: {self.titles[0]} brighter; full scale {scale:.2g}",
                difference_picture(self.image, self.reference, scale),
            ),
        ]
        return captioned_sheet([replace(tile, picture=enlarged(tile.picture)) for tile in tiles], palette=DARK)

    def rows(self, measures: tuple[str, ...] = ALWAYS) -> list[tuple[str, str, str, str]]:
        """The rows of the table: (what, value, limit, verdict), with these measures and those that have limits."""
        rows = [self._row("rmse")]
        if not math.isnan(self.noise_rmse):
            rows.append(("  expected from noise", f"{self.noise_rmse:.5g}", "", ""))
        rows.append(("relative RMSE", f"{self.relative_rmse:.5g}", "", ""))
        rows += [self._row(name) for name in MEASURES if name in {*measures, *self.limits} - {"rmse", "bias"}]
        _, _, limit, verdict = self._row("bias")
        rows.append(("mean bias", f"{self.bias:+.3g} ({self.relative_bias:+.3%})", limit, verdict))
        if not math.isnan(self.noise_ratio):
            names = f"noise, {'ours' if self.titles[0] == 'djpt' else self.titles[0]} / {self.titles[1]}"
            rows.append((names, f"{self.noise_ratio:.3f}", "", ""))
        for test in self.tests:
            limit = f"{test.critical:.2f}, detects {100 * test.detectable:.2g} % of the mean"
            rows.append((f"worst z, {test.name}", f"{test.z:+.2f}", limit, "ok" if test.passed else "FAILED"))
        if self.same_seed:
            share, wanted = self.same_seed.share, self.limits.get("same_seed")
            limit = "" if wanted is None else f"at least {wanted:.2%}"
            verdict = "" if wanted is None else "ok" if share >= wanted else "FAILED"
            what = f"same seed, {self.same_seed_spp} spp" if self.same_seed_spp else "pixels that agree"
            rows.append((what, f"{share:.3%} within {self.same_seed.tolerance:g}", limit, verdict))
        if self.seconds > 0 and self.reference_seconds > 0:
            ours = "ours" if self.titles[0] == "djpt" else self.titles[0]
            text = f"{self.seconds:.3g} s / {self.reference_seconds:.3g} s"
            rows.append((f"time of {self.batch_spp} spp, {ours} / {self.titles[1]}", text, f"{self.speed:.3g} x", ""))
        return rows

    def _row(self, name: str) -> tuple[str, str, str, str]:
        measure, value, limit = MEASURES[name], self.measure(name), self.limits.get(name)
        if limit is None:
            return measure.title, f"{value:.5g}", "", ""
        side = "at most" if measure.closer == "less" else "at least"
        return measure.title, f"{value:.5g}", f"{side} {limit:g}", "ok" if within(name, value, limit) else "FAILED"

    def __str__(self) -> str:
        height, width, _ = self.image.shape
        sides = [
            f"{title} at {spp} spp" if spp else title
            for title, spp in zip(self.titles, (self.spp, self.reference_spp), strict=True)
        ]
        title = f"{self.name}, {width} x {height}: {sides[0]}, {sides[1]}"
        return "\n".join([title, *aligned(self.rows()), self.verdict])

    def summary(self) -> dict[str, Any]:
        """The numbers and the verdict as JSON can hold them; NaN and infinity are None."""
        height, width, channels = self.image.shape
        measured = {name: self.measure(name) for name in MEASURES if name in {*ALWAYS, "rmse", "bias", *self.limits}}
        return {
            "name": self.name,
            "titles": list(self.titles),
            "size": [width, height, channels],
            "spp": [self.spp, self.reference_spp],
            "batch_spp": self.batch_spp,
            "measures": {name: finite(value) for name, value in measured.items()},
            "mean_bias": finite(self.bias),
            "noise_rmse": finite(self.noise_rmse),
            "noise_ratio": finite(self.noise_ratio),
            "tests": [
                {
                    "name": test.name,
                    "count": test.count,
                    "z": finite(test.z),
                    "critical": test.critical,
                    "p_value": test.p_value,
                    "where": list(test.where),
                    "passed": test.passed,
                }
                for test in self.tests
            ],
            "same_seed": None if self.same_seed is None else self.same_seed.share,
            "limits": dict(self.limits),
            "failures": self.failures,
            "checks": self.checks,
            "passed": self.passed,
        }


def finite(value: float) -> float | None:
    """A number that JSON can hold."""
    return float(value) if math.isfinite(value) else None
