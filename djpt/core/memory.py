"""The memory that this process can still take.

Where memory ends while kernels run, the process ends, too: Dr.Jit has no way to tell. So large needs are estimated
before they arise.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import drjit as dr

from djpt.jit.types import Float

__all__ = ["RESERVE", "free_memory", "shortage"]

RESERVE = 2**29
"""Bytes for kernels and for all else that isn't estimated."""

SMALL = RESERVE + 2**26
"""Bytes that are there without asking."""


def shortage(needed: int) -> str | None:
    """The missing memory, for a message, if `needed` bytes are more than is free; None if they are there."""
    if needed <= SMALL:
        return None
    free = free_memory()
    if free is None or needed <= free:
        return None
    return f"takes about {gibibytes(needed)}; {gibibytes(free)} are free"


def gibibytes(count: int) -> str:
    """A number of bytes for messages."""
    return f"{count / 2**30:.1f} GiB"


def free_memory() -> int | None:
    """The bytes that this process can still take, as far as the system says so; None where it doesn't.

    The least of what the machine has, what the process's group may take (Linux's control groups) and what its
    addresses reach (`ulimit -v`).
    """
    if dr.backend_v(Float) != dr.JitBackend.LLVM:
        return None  # Dr.Jit asks the device by itself, and raises an error
    return min((max(0, free) for free in limits()), default=None)


def limits() -> Iterator[int]:
    """The bytes that each of the limits leaves."""
    with suppress(OSError, ValueError, KeyError):
        meminfo = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text().splitlines())
        yield int(meminfo["MemAvailable"].split()[0]) * 1024
    with suppress(OSError, ValueError):
        group = Path("/sys/fs/cgroup")
        parts = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
        # Cached files give way to what needs memory.
        taken = int((group / "memory.current").read_text()) - int(parts.get("file", 0))
        yield int((group / "memory.max").read_text()) - taken
    if sys.platform == "linux":
        import resource

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most != resource.RLIM_INFINITY:
            taken = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
            yield most - taken
