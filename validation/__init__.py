"""The bridge to Mitsuba 3, which validation compares with: metrics, statistics, reports."""

from __future__ import annotations

if __name__ != "djpt.validation":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.validation instead")
