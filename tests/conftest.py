"""Import djpt before anything imports Dr.Jit or Mitsuba: it chooses the LLVM library that they open."""

from __future__ import annotations

from kit.lanes import lanes_from_environment

import djpt  # noqa: F401

lanes_from_environment()
