"""Passes: which samples are computed when, and how they add up to an image.

Passes bound memory and let progress be shown. They split the grid into bands of rows and the samples
of each pixel into ranges; sums are carried from pass to pass, so that the image is the same, bit for bit,
for any split. While the kernels of a pass run, Python prepares the next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import drjit as dr

from djpt.description.frozen import recording
from djpt.errors import RenderError
from djpt.kernels import while_loop
from djpt.llvm.lanes import small_blocks
from djpt.schedules.canvas import Canvas
from djpt.schedules.job import Band, Job
from djpt.schedules.reconstruction import Rows, Spread, add_box, add_samples, collected
from djpt.types import Event, Float, TensorXf, UInt32

__all__ = [
    "AddToFilm",
    "Samples",
    "filtered_image",
    "image_of_samples",
    "one_ahead",
    "ranges",
    "register_spp",
    "report",
    "stored_image",
    "stored_passes",
    "stored_pixels",
    "summed_image",
]

T = TypeVar("T")

PASS_SAMPLES = 2**26
"""The number of samples of one kernel launch when nothing is stored: about a second on two cores."""

STORED_SAMPLES = 2**22
"""Samples whose values are held at once: 64 per pixel of a band keep lanes busy; more would outgrow the caches."""

SUMMED_PIXELS = 2**20
"""The number of pixels of a band when samples are added up in registers: 16 bytes of memory and more for each."""

FILTERED_PIXELS = 2**18
"""The same with a filter, whose sums take up to a kilobyte per pixel."""

STORED_PIXELS = 2**16, 2**17
"""The numbers of pixels of a band when samples are stored: with many per pixel, and with few."""

AddToFilm = Callable[[Job, Band, int, int, "list[Float] | None"], list[Float]]
"""Adds the samples begin <= k < end of a band to the lanes' sums."""

Samples = Callable[[Job, Band, int, int], list[Float]]
"""Computes the samples begin <= k < end of a band: per channel an array [k - begin][pixel]."""


# ---- images ----------------------------------------------------------------------------------


def stored_image(job: Job, samples: Samples, pixels: int = 0, spp: int = 0) -> TensorXf:
    """The image from samples that are stored, by bands of `pixels` and passes of `spp` samples per pixel; 0: few."""
    pixels, spp = pixels or stored_pixels(job), spp or stored_spp(job)
    if job.film.filters:

        def add(job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
            return add_samples(job, band, computed(samples, job, band, begin, end), begin, end, sums)

        return filtered_image(job, add, pixels, spp)

    def add_unweighted(job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
        return add_box(job, band, computed(samples, job, band, begin, end), begin, end, sums)

    return unfiltered_image(job, add_unweighted, pixels, spp)


def summed_image(job: Job, add: AddToFilm) -> TensorXf:
    """The image from samples that `add` adds up in registers, lane by lane, without a filter."""
    return unfiltered_image(job, add, SUMMED_PIXELS, register_spp(job))


def unfiltered_image(job: Job, add: AddToFilm, pixels: int, spp: int) -> TensorXf:
    """The image from plain sums, by bands of `pixels` and passes of `spp` samples per pixel."""
    canvas, weight = Canvas(job, job.channel_count()), dr.opaque(Float, job.spp)
    for band, sums in sums_of_bands(job, add, pixels, spp):
        canvas.develop(Rows(band.first_row, band.rows, total(job, band, sums)), weight)
    return canvas.image()


def filtered_image(job: Job, add: AddToFilm, pixels: int = 0, spp: int = 0, spread: Spread | None = None) -> TensorXf:
    """The image from sums for a filter, by bands of `pixels` and passes of `spp` samples per pixel; 0: many.

    `spread` reads the sums that `add` makes: see `collected`.
    """
    canvas = Canvas(job, job.channel_count())
    bands = sums_of_bands(job, add, pixels or FILTERED_PIXELS, spp or register_spp(job))
    for rows in collected(job, bands, job.channel_count() + 1, spread):
        canvas.develop(rows, rows.sums[-1])
    return canvas.image()


def image_of_samples(job: Job, samples: list[Float]) -> TensorXf:
    """The image from all samples at once."""
    band, canvas = Band(0, job.height), Canvas(job, len(samples))
    if not job.film.filters:
        sums = add_box(job, band, samples, 0, job.spp, None)
        canvas.develop(Rows(0, job.height, sums), dr.opaque(Float, job.spp))
        return canvas.image()
    sums = add_samples(job, band, samples, 0, job.spp, None)
    for rows in collected(job, [(band, sums)], len(samples) + 1):
        canvas.develop(rows, rows.sums[-1])
    return canvas.image()


# ---- sums ------------------------------------------------------------------------------------


def sums_of_bands(job: Job, add: AddToFilm, pixels: int, spp: int) -> Iterator[tuple[Band, list[Float]]]:
    """The lanes' sums of all samples, band by band."""
    for band in one_ahead(job.bands(pixels)):
        sums = None
        for begin, end in ranges(job.spp, job.pass_spp or spp):
            sums = add(job, band, begin, end, sums)
            report(job, (band.first_row * job.spp + band.rows * end) * job.width)
        assert sums is not None
        yield band, sums


def total(job: Job, band: Band, sums: list[Float]) -> list[Float]:
    """The sums of a band's pixels, each added up over its lanes."""
    pixels = band.rows * job.width
    groups = dr.width(sums[0]) // pixels
    count, pixel = dr.opaque(UInt32, groups), dr.arange(UInt32, pixels)
    stride = dr.opaque(UInt32, pixels)

    def body(g: UInt32, out: list[Float]) -> tuple[UInt32, list[Float]]:
        return g + 1, [o + dr.gather(Float, s, dr.fma(g, stride, pixel)) for o, s in zip(out, sums, strict=True)]

    start = [dr.opaque(Float, 0, pixels) for _ in sums]
    _, result = while_loop((dr.zeros(UInt32, pixels), start), lambda g, out: g < count, body, label="total")
    dr.eval(result)
    return result


def computed(samples: Samples, job: Job, band: Band, begin: int, end: int) -> list[Float]:
    """Evaluated samples: gathers from an unevaluated result would run its kernel once per channel."""
    values = samples(job, band, begin, end)
    with small_blocks():
        dr.eval(values)
    return values


# ---- passes ----------------------------------------------------------------------------------


def stored_passes(job: Job) -> Iterator[tuple[Band, int, int]]:
    """The passes of a job whose samples are stored: (band, begin, end)."""
    for band in one_ahead(job.bands(stored_pixels(job))):
        for begin, end in ranges(job.spp, stored_spp(job)):
            yield band, begin, end


def register_spp(job: Job) -> int:
    """Samples per pixel of a pass that stores nothing."""
    largest = FILTERED_PIXELS if job.film.filters else SUMMED_PIXELS
    return max(1, PASS_SAMPLES // min(job.width * job.height, largest))


def stored_pixels(job: Job) -> int:
    """The number of pixels of a band whose samples are stored."""
    low, high = STORED_PIXELS
    return max(low, min(high, STORED_SAMPLES // job.spp))


def stored_spp(job: Job) -> int:
    """Samples per pixel that a pass over a band may store."""
    return max(1, STORED_SAMPLES // min(job.width * job.height, max(stored_pixels(job), job.width)))


def ranges(spp: int, size: int) -> Iterator[tuple[int, int]]:
    """Split 0 .. spp into passes of at most `size`."""
    for begin in one_ahead(range(0, spp, size)):
        yield begin, min(begin + size, spp)


def one_ahead(items: Iterable[T]) -> Iterator[T]:
    """The items of a loop that launches kernels: Python is never more than one of them ahead of the kernels.

    Kernels are launched asynchronously, and what all of them need together must not pile up in memory.
    """
    before = None
    for number, item in enumerate(items):
        # Nobody waits between the kernels of a frozen function.
        if number and not recording():
            launched = Event()
            launched.record()
            if before is not None:
                before.wait()
            before = launched
        yield item


def report(job: Job, done: int) -> None:
    """Tell the caller's progress function; waits for the kernel, so that the number is true.

    Raises:
        RenderError: The integrator was asked to stop.
    """
    if job.integrator.should_stop():
        raise RenderError(f"{job.integrator.id()}: the rendering was cancelled")
    if job.progress is not None:
        dr.sync_thread()
        job.progress(done, job.samples)
