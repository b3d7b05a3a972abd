"""The memory that a render will take, compared with what is free before it starts."""

from __future__ import annotations

from djpt.core.memory import RESERVE, free_memory, shortage
from djpt.errors import RenderError
from djpt.rendering.schedules.called_sums import CHANNELS
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.lanes import lanes_per_pixel
from djpt.rendering.schedules.reconstruction import by_pixels

__all__ = ["check_memory", "holds_all_sums", "needed_memory"]

MAX_NUMBERS = 2**32 - 1
"""The entries of the largest array of Dr.Jit."""

WORKING = 2**17, 64
"""Pixels that are worked on at once, and numbers that are held for each channel of one: sums and samples."""

WITHOUT_LIMIT = 2**32
"""The bytes that are taken for free where nothing is known of them."""

SAMPLE_OF_PLAIN_AD = 2
"""Numbers that plain AD holds for each channel of a sample."""

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
    missing = shortage(needed_memory(job, attached, in_bands))
    if missing is not None:
        raise RenderError(f"{what} {missing}; {remedy}")


def needed_memory(job: Job, attached: bool = False, in_bands: bool = False) -> int:
    """An estimate of the memory of a render in bytes; the arguments are those of `check_memory`."""
    width, height = job.film.crop_size()
    pixels, channels = width * height, job.channel_count() + len(job.integrator.unfiltered_names())
    most, numbers = WORKING
    images = 0 if in_bands else 1 + IMAGES_OF_DERIVATIVES * attached
    # Plain AD holds the samples, and what they were computed from.
    samples = SAMPLE_OF_PLAIN_AD * job.samples if attached and not job.integrator.replays else 0
    held = job.integrator.held_bytes() + (held_sums(job) if job.integrator.holds_sums else 0)
    # A band has at least one row.
    return held + 4 * channels * (images * pixels + samples + numbers * max(width, min(pixels, most))) + RESERVE


def holds_all_sums(job: Job) -> bool:
    """Whether the sums of all of an image's lanes may be held at once, in a quarter of what is free."""
    free = free_memory()
    return 4 * held_sums(job) < (WITHOUT_LIMIT if free is None else free)


def held_sums(job: Job) -> int:
    """The bytes of the sums of all lanes of an image."""
    channels = job.channel_count()
    if job.film.filters:
        of_pixels = channels <= len(CHANNELS) or by_pixels(job, channels + 1)
        sums = (channels + 1) * job.film.taps ** (2 if of_pixels else 1)
    else:
        sums = channels
    return 4 * job.width * job.height * lanes_per_pixel(job.width * job.height, job.spp) * sums
