"""Validation against Mitsuba 3: the bridge to it, metrics, statistics, reports."""

from __future__ import annotations

if __name__ != "djpt.validation":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.validation instead")

from djpt.validation.bridge import mitsuba_renderer, render_in_mitsuba, to_mitsuba
from djpt.validation.compare import Comparison, assert_matches, compare, compare_renderers
from djpt.validation.gradcheck import GradientCheck, check_gradient
from djpt.validation.metrics import ComparisonError, mean_bias, relative_bias, relative_rmse, rmse
from djpt.validation.same_seed import Agreement, agreement
from djpt.validation.statistics import Batches, TestResult, block_test, mean_test, pixel_test

__all__ = [
    "Agreement",
    "Batches",
    "Comparison",
    "ComparisonError",
    "GradientCheck",
    "TestResult",
    "agreement",
    "assert_matches",
    "block_test",
    "check_gradient",
    "compare",
    "compare_renderers",
    "mean_bias",
    "mean_test",
    "mitsuba_renderer",
    "pixel_test",
    "relative_bias",
    "relative_rmse",
    "render_in_mitsuba",
    "rmse",
    "to_mitsuba",
]
