"""Validation against Mitsuba 3: the bridge to it, metrics, statistics, reports."""

from __future__ import annotations

if __name__ != "djpt.validation":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.validation instead")

from djpt.validation.bridge import mitsuba_renderer, render_in_mitsuba, to_mitsuba
from djpt.validation.compare import assert_matches, compare, compare_renderers, store_reference
from djpt.validation.comparison import Agreement, Comparison, agreement
from djpt.validation.gradcheck import GradientCheck, check_gradient
from djpt.validation.metrics import (
    ComparisonError,
    flip,
    hdr_flip,
    mae,
    mean_bias,
    psnr,
    relative_bias,
    relative_mse,
    relative_rmse,
    rmse,
    ssim,
)
from djpt.validation.references import Reference, read_reference, write_reference
from djpt.validation.statistics import Batches, TestResult, block_test, mean_test, pixel_test

__all__ = [
    "Agreement",
    "Batches",
    "Comparison",
    "ComparisonError",
    "GradientCheck",
    "Reference",
    "TestResult",
    "agreement",
    "assert_matches",
    "block_test",
    "check_gradient",
    "compare",
    "compare_renderers",
    "flip",
    "hdr_flip",
    "mae",
    "mean_bias",
    "mean_test",
    "mitsuba_renderer",
    "pixel_test",
    "psnr",
    "read_reference",
    "relative_bias",
    "relative_mse",
    "relative_rmse",
    "render_in_mitsuba",
    "rmse",
    "ssim",
    "store_reference",
    "to_mitsuba",
    "write_reference",
]
