"""Passes: which samples are computed when, and how they add up to the rows of an image.

Passes bound memory and let progress be shown. They split the grid into bands of rows and the samples
of each pixel into ranges; sums are carried from pass to pass, so that the image is the same, bit for bit,
for any split. While the kernels of a pass run, Python prepares the next.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import drjit as dr

from djpt.errors import RenderError
from djpt.jit.frozen import recording
from djpt.jit.kernels import while_loop
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Event, Float, TensorXf, UInt32
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.memory import holds_all_sums
from djpt.rendering.schedules.reconstruction import Rows, Spread, Summed, add_box, add_samples, collected, image_of_rows

__all__ = [
    "Pace",
    "computed",
    "filtered_rows",
    "image_of_samples",
    "one_ahead",
    "ranges",
    "register_spp",
    "report",
    "stored_passes",
    "stored_pixels",
    "stored_rows",
    "summed_rows",
]

SECONDS = 1.0
"""The time of a pass."""

FIRST = 2**20
"""The number of samples of the first pass."""

GROWTH = 8
"""The largest ratio of the samples of a pass to those of the one before, which may have waited for a compiler."""


class Pace:
    """The speed of a job's passes.

    A pass takes about a second while somebody waits for its end: to see progress, or to stop. The clock decides how the
    samples are split into passes, which changes no bit of the image.
    """

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


T = TypeVar("T")

PASS_SAMPLES = 2**26
"""The number of samples of one kernel launch when nothing is stored: about a second on two cores."""

STORED_SAMPLES = 2**22
"""Samples whose values are held at once: 64 per pixel of a band keep lanes busy; more would outgrow the caches."""

SUMMED_PIXELS = 2**20
"""The number of pixels of a band when samples are added up in registers: 16 bytes of memory and more for each."""

FILTERED_PIXELS = 2**18
"""The number of pixels of a band with a filter, whose sums take up to a kilobyte per pixel."""

STORED_PIXELS = 2**16, 2**17
"""The numbers of pixels of a band when samples are stored: with many per pixel, and with few."""

AddToFilm = Callable[[Job, Band, int, int, "list[Float] | None"], list[Float]]
"""Adds the samples begin <= k < end of a band to the lanes' sums."""

Samples = Callable[[Job, Band, int, int], list[Float]]
"""Computes the samples begin <= k < end of a band: per channel an array [k - begin][pixel]."""


# ---- finished rows ---------------------------------------------------------------------------


def stored_rows(job: Job, samples: Samples, pixels: int = 0, spp: int = 0) -> Iterator[Summed]:
    """Rows from samples that are stored, by bands of `pixels` and passes of `spp` samples per pixel; 0: few."""
    pixels, spp = pixels or stored_pixels(job), spp or stored_spp(job)
    if job.film.filters:

        def add(job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
            return add_samples(job, band, computed(samples, job, band, begin, end), begin, end, sums)

        return filtered_rows(job, add, pixels, spp)

    def add_unweighted(job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
        return add_box(job, band, computed(samples, job, band, begin, end), begin, end, sums)

    return unfiltered_rows(job, add_unweighted, pixels, spp)


def summed_rows(job: Job, add: AddToFilm) -> Iterator[Summed]:
    """Rows from samples that `add` adds up in registers, lane by lane, without a filter."""
    return unfiltered_rows(job, add, SUMMED_PIXELS, register_spp(job))


def unfiltered_rows(job: Job, add: AddToFilm, pixels: int, spp: int) -> Iterator[Summed]:
    """Rows from plain sums, by bands of `pixels` and passes of `spp` samples per pixel."""
    for band, sums, count in sums_of_bands(job, add, pixels, spp):
        yield Rows(band.first_row, band.rows, total(job, band, sums)), dr.opaque(Float, count)


def filtered_rows(
    job: Job, add: AddToFilm, pixels: int = 0, spp: int = 0, spread: Spread | None = None
) -> Iterator[Summed]:
    """Rows from sums for a filter, by bands of `pixels` and passes of `spp` samples per pixel; 0: many.

    `spread` reads the sums that `add` makes: see `collected`.
    """
    bands = sums_of_bands(job, add, pixels or FILTERED_PIXELS, spp or register_spp(job))
    for rows in collected(job, ((band, sums) for band, sums, _ in bands), job.channel_count() + 1, spread):
        yield rows, rows.sums[-1]


def image_of_samples(job: Job, samples: list[Float]) -> TensorXf:
    """The image from all samples at once."""
    band = Band(0, job.height)
    if not job.film.filters:
        sums = add_box(job, band, samples, 0, job.spp, None)
        return image_of_rows(job, [(Rows(0, job.height, sums), dr.opaque(Float, job.spp))])
    sums = add_samples(job, band, samples, 0, job.spp, None)
    finished = collected(job, [(band, sums)], len(samples) + 1)
    return image_of_rows(job, ((rows, rows.sums[-1]) for rows in finished))


# ---- sums ------------------------------------------------------------------------------------


def sums_of_bands(job: Job, add: AddToFilm, pixels: int, spp: int) -> Iterator[tuple[Band, list[Float], int]]:
    """The lanes' sums band by band, of as many samples per pixel as are given with them.

    Ends early if what exists is asked for: see `Job.interruption`.
    """
    if job.interruption is not None and job.interruption.keeps and holds_all_sums(job):
        yield from sums_of_passes(job, add, pixels, spp)
        return
    pace = Pace(job, spp)
    for band in one_ahead(job.bands(pixels)):
        sums = None
        for begin, end in one_ahead(pace.passes(band.rows * job.width)):
            sums = add(job, band, begin, end, sums)
            report(job, (band.first_row * job.spp + band.rows * end) * job.width)
            if ends_here(job) and end < job.spp:
                return
        assert sums is not None
        yield band, sums, job.spp
        if ends_here(job):
            return


def sums_of_passes(job: Job, add: AddToFilm, pixels: int, spp: int) -> Iterator[tuple[Band, list[Float], int]]:
    """`sums_of_bands` with passes over all bands, one after the other: at any time all pixels have some samples.

    The sums of all lanes are held meanwhile. The first sample of each pixel is always taken.
    """
    held: list[tuple[Band, list[Float] | None, int]] = [(band, None, 0) for band in job.bands(pixels)]
    done = 0
    for begin, end in Pace(job, spp).passes(job.width * job.height):
        for i, (band, sums, count) in enumerate(one_ahead(held)):
            if ends_here(job):
                if begin:
                    break
                end = 1 if job.splits_freely else end
            held[i] = band, add(job, band, begin, end, sums), end
            done += band.rows * job.width * (end - count)
            report(job, done)
        if ends_here(job):
            break
    for i, (band, sums, count) in enumerate(held):
        assert sums is not None
        held[i] = band, None, 0
        yield band, sums, count


def ends_here(job: Job) -> bool:
    """Whether the image is to be made from what has been computed."""
    return job.interruption is not None and job.interruption.ends_kept


def total(job: Job, band: Band, sums: list[Float]) -> list[Float]:
    """The sums of a band's pixels, each added up over its lanes, which stand side by side."""
    pixels = band.rows * job.width
    count = dr.opaque(UInt32, dr.width(sums[0]) // pixels)
    first = dr.arange(UInt32, pixels) * count

    def body(g: UInt32, out: list[Float]) -> tuple[UInt32, list[Float]]:
        return g + 1, [o + dr.gather(Float, s, first + g) for o, s in zip(out, sums, strict=True)]

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


def stored_passes(job: Job, most: int | None = None) -> Iterator[tuple[Band, int, int]]:
    """The passes of a job whose samples are stored, at most so many of each pass: (band, begin, end).

    The default is `STORED_SAMPLES`; there is at least one of each pixel of a band.
    """
    for band in one_ahead(job.bands(stored_pixels(job))):
        for begin, end in ranges(job.spp, stored_spp(job, most)):
            yield band, begin, end


def register_spp(job: Job) -> int:
    """Samples per pixel of a pass that stores nothing."""
    largest = FILTERED_PIXELS if job.film.filters else SUMMED_PIXELS
    return max(1, PASS_SAMPLES // min(job.width * job.height, largest))


def stored_pixels(job: Job) -> int:
    """The number of pixels of a band whose samples are stored."""
    low, high = STORED_PIXELS
    return max(low, min(high, STORED_SAMPLES // job.spp))


def stored_spp(job: Job, most: int | None = None) -> int:
    """Samples per pixel that a pass over a band may store."""
    return max(1, (most or STORED_SAMPLES) // min(job.width * job.height, max(stored_pixels(job), job.width)))


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
    """Tell the caller's progress function; waits for the kernel if somebody is told, so that the number is true.

    Raises:
        RenderError: The integrator was asked to stop.
        KeyboardInterrupt: A signal has come, and nothing is to be kept; `djpt.Terminated` for SIGTERM.
    """
    if job.integrator.should_stop():
        raise RenderError(f"{job.integrator.id()}: the rendering was cancelled")
    if job.is_watched:
        dr.sync_thread()
    if job.interruption is not None:
        job.interruption.done, job.interruption.total = done, job.samples
        job.interruption.check()
    if job.progress is not None:
        job.progress(done, job.samples)
