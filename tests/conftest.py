"""Import djpt before anything imports Dr.Jit or Mitsuba: it chooses the LLVM library that they open."""

from __future__ import annotations

from typing import Any

import pytest

import djpt  # noqa: F401

pytest.register_assert_rewrite("tests.kit")


@pytest.fixture(scope="module")
def mi() -> Any:
    """Mitsuba, in the variant whose arrays are djpt's; the test is skipped where it isn't installed."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    return mitsuba
