"""Import djpt before anything imports Dr.Jit or Mitsuba: it chooses the LLVM library that they open."""

from __future__ import annotations

import djpt  # noqa: F401
from tests.kit.lanes import lanes_from_environment

lanes_from_environment()
