"""Small things around a run: processors, times and sizes as text, a stopwatch, version numbers. Mitsuba's `misc`."""

from __future__ import annotations

import os
import time
from functools import total_ordering
from typing import overload

from drjit import while_loop

from djpt.errors import DjptError

__all__ = ["Timer", "Version", "core_count", "mem_string", "time_string", "while_loop"]

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


# ---- stopwatch, version numbers, loops -------------------------------------------------------


class Timer:
    """A stopwatch in whole milliseconds, which runs from its making on."""

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._stages: dict[str, float] = {}

    def value(self) -> int:
        """The time since the start."""
        return int(1000 * (time.perf_counter() - self._start))

    def reset(self) -> int:
        """Start anew; the time until now."""
        value, self._start = self.value(), time.perf_counter()
        return value

    def begin_stage(self, name: str, /) -> None:
        """Note the beginning of a part."""
        self._stages[name] = time.perf_counter()

    def end_stage(self, name: str, /) -> None:
        """Print how long a part took.

        Raises:
            DjptError: the part hasn't begun.
        """
        if name not in self._stages:
            raise DjptError(f"Timer.end_stage: '{name}' hasn't begun")
        print(f"{name}: took {1000 * (time.perf_counter() - self._stages.pop(name)):.0f} ms")


@total_ordering
class Version:
    """Three numbers that can be compared: ``Version(3, 9, 1)`` or ``Version("3.9.1")``; by default 0.0.0."""

    @overload
    def __init__(self) -> None: ...
    @overload
    def __init__(self, value: str) -> None: ...
    @overload
    def __init__(self, major: int, minor: int, patch: int) -> None: ...

    # The overloads name their first argument differently.
    def __init__(self, major: int | str = 0, minor: int = 0, patch: int = 0, *, value: str | None = None) -> None:  # type: ignore[misc]
        text = value if value is not None else major
        numbers = [int(part) for part in text.split(".")] if isinstance(text, str) else [text, minor, patch]
        if len(numbers) != 3:
            raise DjptError(f"a version has three numbers such as 3.9.1, found '{text}'")
        self.major_version, self.minor_version, self.patch_version = numbers

    def _numbers(self) -> tuple[int, int, int]:
        return self.major_version, self.minor_version, self.patch_version

    def __eq__(self, other: object) -> bool:
        return self._numbers() == other._numbers() if isinstance(other, Version) else NotImplemented

    def __lt__(self, other: Version) -> bool:
        return self._numbers() < other._numbers()

    def __hash__(self) -> int:
        return hash(self._numbers())

    def __repr__(self) -> str:
        return ".".join(map(str, self._numbers()))
