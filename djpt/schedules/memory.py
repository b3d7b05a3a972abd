"""The memory that a render will take, compared with what is free before it starts.

Where memory ends while kernels run, the process ends, too: Dr.Jit has no way to tell.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import drjit as dr

from djpt.errors import RenderError
from djpt.schedules.job import Job
from djpt.schedules.lanes import lanes_per_pixel
from djpt.schedules.reconstruction import by_pixels
from djpt.types import Float

__all__ = ["check_memory", "free_memory", "holds_all_sums", "needed_memory"]

MAX_NUMBERS = 2**32 - 1
"""The entries of the largest array of Dr.Jit."""

WORKING = 2**17, 64
"""Pixels that are worked on at once, and numbers that are held for each channel of one: sums and samples."""

RESERVE = 2**29
"""Bytes for kernels and for all else that a render needs."""

SMALL = RESERVE + 2**26
"""Bytes that are there without asking."""

WITHOUT_LIMIT = 2**32
"""The bytes that are taken for free where nothing is known of them."""

IMAGES_OF_DERIVATIVES = 3
"""Images that a derivative holds besides the image itself: that of the pixels, of the sums, and of the weights."""


def check_memory(job: Job, attached: bool = False, in_bands: bool = False) -> None:
    """Raise `RenderError` if what a job takes is more than is free.

    Args:
        job: The render.
        attached: with derivatives.
        in_bands: the image itself isn't held.
    """
    width, height = job.film.crop_size()
    channels = job.channel_count() + len(job.integrator.unfiltered_names())
    what = f"{job.film.id()}: an image of {width} x {height} pixels with {channels} channels"
    remedy = "write it row by row (djpt.render_to_file), render it in parts ('crop_offset_x', 'crop_width', ..)"
    if attached or in_bands:
        remedy = "render it in parts ('crop_offset_x', 'crop_width', ..)"
    remedy += " or with fewer channels"
    if not in_bands and width * height * channels > MAX_NUMBERS:
        raise RenderError(f"{what} has more than 2^32 numbers; {remedy}")
    needed = needed_memory(job, attached, in_bands)
    if needed <= SMALL:
        return
    free = free_memory()
    if free is not None and needed > free:
        raise RenderError(f"{what} takes about {gibibytes(needed)}; {gibibytes(free)} are free; {remedy}")


def needed_memory(job: Job, attached: bool = False, in_bands: bool = False) -> int:
    """An estimate of the memory of a render in bytes; the arguments are those of `check_memory`."""
    width, height = job.film.crop_size()
    pixels, channels = width * height, job.channel_count() + len(job.integrator.unfiltered_names())
    most, numbers = WORKING
    images = 0 if in_bands else 1 + IMAGES_OF_DERIVATIVES * attached
    # A band has at least one row.
    return 4 * channels * (images * pixels + numbers * max(width, min(pixels, most))) + RESERVE


def holds_all_sums(job: Job) -> bool:
    """Whether the sums of all of an image's lanes may be held at once, in a quarter of what is free."""
    free = free_memory()
    return 4 * held_sums(job) < (WITHOUT_LIMIT if free is None else free)


def held_sums(job: Job) -> int:
    """The bytes of the sums of all lanes of an image."""
    channels = job.channel_count()
    if job.film.filters:
        sums = (channels + 1) * job.film.taps ** (2 if by_pixels(job, channels + 1) else 1)
    else:
        sums = channels
    return 4 * job.width * job.height * lanes_per_pixel(job.width * job.height, job.spp) * sums


def gibibytes(count: int) -> str:
    """A number of bytes for messages."""
    return f"{count / 2**30:.1f} GiB"


# ---- what is free --------------------------------------------------------------------------


def free_memory() -> int | None:
    """The bytes that this process can still take, as far as the system says so; None where it doesn't.

    The least of what the machine has, what the process's group may take (Linux's control groups) and what its
    addresses reach (`ulimit -v`).
    """
    if dr.backend_v(Float) != dr.JitBackend.LLVM:
        return None  # Dr.Jit asks the device by itself, and raises an error
    return min((max(0, free) for free in limits()), default=None)


def limits() -> Iterator[int]:
    """What each of the limits leaves."""
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
