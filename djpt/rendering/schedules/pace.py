"""The size of passes while somebody waits for their ends: to see progress, or to stop.

A pass then takes about a second. The clock decides how the samples are split into passes, which changes no bit of the
image.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

from djpt.rendering.schedules.job import Job

__all__ = ["Pace"]

SECONDS = 1.0
"""The time of a pass."""

FIRST = 2**20
"""The number of samples of the first pass."""

GROWTH = 8
"""How many times more samples a pass may have than the one before, whose time may have been that of a compiler."""


class Pace:
    """How fast a job's passes are."""

    def __init__(self, job: Job, largest: int) -> None:
        """`largest`: the most samples per pixel of a pass, which all have that don't go by the clock."""
        self._job, self._largest = job, job.pass_spp or largest
        self._by_clock = job.is_watched and job.splits_freely and not job.pass_spp
        self._samples = FIRST

    def passes(self, pixels: int) -> Iterator[tuple[int, int]]:
        """The passes (begin, end) over some pixels. Each must have ended before the next one is asked for."""
        begin = 0
        while begin < self._job.spp:
            size = self._largest
            if self._by_clock:
                size = max(1, min(size, self._samples // pixels))
            end = min(begin + size, self._job.spp)
            start = time.perf_counter()
            yield begin, end
            self._took((end - begin) * pixels, time.perf_counter() - start)
            begin = end

    def _took(self, samples: int, seconds: float) -> None:
        rate = samples / max(seconds, 1e-6)
        self._samples = max(1, min(int(rate * SECONDS), GROWTH * self._samples))
