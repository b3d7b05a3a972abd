"""Import djpt before anything imports Dr.Jit or Mitsuba: it chooses the LLVM library that they open."""

from __future__ import annotations

import os
from typing import Any

import pytest

import djpt  # noqa: F401 isort: skip
import drjit as dr

pytest.register_assert_rewrite("tests.kit")

from tests.kit.lanes import lanes_from_environment  # noqa: E402

lanes_from_environment()

# Processes that run tests side by side (`pytest -n`) share the processors. With a single thread Mitsuba waits for ever
# for the second when it reads an EXR file.
if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    dr.set_thread_count(max(2, (os.cpu_count() or 1) // int(os.environ["PYTEST_XDIST_WORKER_COUNT"])))


@pytest.fixture(scope="module")
def mi() -> Any:
    """Mitsuba, in the variant whose arrays are djpt's; the test is skipped where it isn't installed."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    return mitsuba
