"""Small things around a run: processors, and times and sizes as text."""

from __future__ import annotations

import os

__all__ = ["core_count", "mem_string", "time_string"]

SECOND = 1000.0
DAY = 24 * 3600 * SECOND
TIMES = {"ms": 1.0, "s": SECOND, "m": 60 * SECOND, "h": 3600 * SECOND, "d": DAY, "w": 7 * DAY, "y": 365.0003 * DAY}
"""Units of time in milliseconds; a year has 52.1429 weeks."""

SIZES = ["B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB"]


def core_count() -> int:
    """The number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def time_string(time: float, precise: bool = False) -> str:
    """A time in milliseconds as text, such as ``2.01s``.

    Args:
        time: milliseconds.
        precise: whether to give more than three digits.
    """
    unit = next((unit for unit in reversed(TIMES) if time > TIMES[unit]), "ms")
    return f"{time / TIMES[unit]:.{5 if precise else 3}g}{unit}"


def mem_string(size: int, precise: bool = False) -> str:
    """A number of bytes as text, such as ``4.88 KiB``.

    Args:
        size: bytes.
        precise: whether to give more than three digits.
    """
    power = next((power for power in reversed(range(len(SIZES))) if size > 1024**power), 0)
    return f"{size / 1024**power:.{5 if precise else 3}g} {SIZES[power]}"
