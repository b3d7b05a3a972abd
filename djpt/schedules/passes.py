"""Passes: which samples are computed when, and how they add up to an image.

Passes bound memory and let progress be shown. They split the samples of each pixel into
ranges, and the grid into bands of rows where samples must be stored; sums are carried from
pass to pass, so that the image is the same, bit for bit, for any split.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr

from djpt.llvm.lanes import small_blocks
from djpt.schedules.job import MAX_SAMPLES, Band, Job
from djpt.schedules.reconstruction import add_box, add_samples, spread
from djpt.types import Float, TensorXf, UInt32

__all__ = [
    "develop",
    "filtered_sums",
    "image_of_samples",
    "picture",
    "ranges",
    "register_spp",
    "stepwise_sums",
    "stored_image",
    "stored_passes",
]

PASS_SAMPLES = 2**26
"""The number of samples of one kernel launch when nothing is stored: about a second on two cores."""

STORED_SAMPLES = 2**22
"""Samples whose values are held at once: 64 per pixel of a band keep lanes busy; more would outgrow the caches."""

BAND_PIXELS = 2**16
"""The number of pixels of a band when samples are stored."""

REGISTER_BAND_PIXELS = 2**18
"""The number of pixels of a band when lanes keep up to `MAX_SUMS` sums: 128 MiB. Each band is traced anew."""

AddToFilm = Callable[[Job, Band, int, int, "list[Float] | None"], list[Float]]
"""Adds the samples begin <= k < end of a band to the film's sums."""

Collect = Callable[[Job, Band, list[Float], list[Float]], list[Float]]
"""Adds a finished band's sums to the image: see `djpt.schedules.reconstruction.spread`."""

Samples = Callable[[Job, Band, int, int], list[Float]]
"""Computes the samples begin <= k < end of a band: per channel an array [k - begin][pixel]."""


def stored_image(job: Job, samples: Samples) -> TensorXf:
    """The image from samples that are stored, pass by pass."""
    if job.film.filters:

        def add(job: Job, band: Band, begin: int, end: int, sums: list[Float] | None) -> list[Float]:
            return add_samples(job, band, computed(samples, job, band, begin, end), begin, end, sums)

        *sums, weight = filtered_sums(job, add, stored_spp(job), BAND_PIXELS)
        return develop(job, sums, weight)
    sums = [dr.concat(parts) for parts in zip(*box_sums(job, samples), strict=True)]
    return develop(job, sums, dr.opaque(Float, job.spp))


def image_of_samples(job: Job, samples: list[Float]) -> TensorXf:
    """The image from all samples at once."""
    band = Band(0, job.height)
    if not job.film.filters:
        return develop(job, add_box(job, band, samples, 0, job.spp, None), dr.opaque(Float, job.spp))
    blank = [dr.opaque(Float, 0, job.width * job.height) for _ in range(len(samples) + 1)]
    *sums, weight = spread(job, band, add_samples(job, band, samples, 0, job.spp, None), blank)
    return develop(job, sums, weight)


def stepwise_sums(job: Job, step: Callable[[int, int, Any], list[Float]]) -> list[Float]:
    """All samples, added up in registers by ``step(begin, end, sums)``."""
    sums = None
    for begin, end in ranges(job.spp, job.pass_spp or register_spp(job)):
        sums = step(begin, end, sums)
        report(job, end * job.width * job.height)
    assert sums is not None
    return total(job, sums)


def total(job: Job, sums: list[Float]) -> list[Float]:
    """The sums of each pixel, added up over its lanes."""
    pixels = job.width * job.height
    groups = dr.width(sums[0]) // pixels
    count, pixel = dr.opaque(UInt32, groups), dr.arange(UInt32, pixels)
    stride = dr.opaque(UInt32, pixels)

    def body(g: UInt32, out: list[Float]) -> tuple[UInt32, list[Float]]:
        return g + 1, [o + dr.gather(Float, s, dr.fma(g, stride, pixel)) for o, s in zip(out, sums, strict=True)]

    start = [dr.opaque(Float, 0, pixels) for _ in sums]
    _, result = dr.while_loop((dr.zeros(UInt32, pixels), start), lambda g, out: g < count, body, label="total")
    dr.eval(result)
    return result


def box_sums(job: Job, samples: Samples) -> Iterator[list[Float]]:
    """Per band, all samples added up pixel by pixel."""
    for band in job.bands(BAND_PIXELS):
        sums = None
        for begin, end in ranges(job.spp, job.pass_spp or stored_spp(job)):
            sums = add_box(job, band, computed(samples, job, band, begin, end), begin, end, sums)
            report(job, (band.first_row * job.spp + band.rows * end) * job.width)
        assert sums is not None
        yield sums


def filtered_sums(
    job: Job, add: AddToFilm, default_spp: int, band_pixels: int, collect: Collect = spread
) -> list[Float]:
    """The weighted sums of all channels and of the weights, over the whole grid, band by band."""
    image = [dr.opaque(Float, 0, job.width * job.height) for _ in range(job.channel_count() + 1)]
    for band in job.bands(band_pixels):
        sums = None
        for begin, end in ranges(job.spp, job.pass_spp or default_spp):
            sums = add(job, band, begin, end, sums)
            report(job, (band.first_row * job.spp + band.rows * end) * job.width)
        assert sums is not None
        image = collect(job, band, sums, image)
        if band.rows < job.height:
            dr.sync_thread()
    return image


def computed(samples: Samples, job: Job, band: Band, begin: int, end: int) -> list[Float]:
    """Evaluated samples: gathers from an unevaluated result would run its kernel once per channel."""
    values = samples(job, band, begin, end)
    with small_blocks():
        dr.eval(values)
    return values


def stored_passes(job: Job) -> Iterator[tuple[Band, int, int]]:
    """The passes of a job whose samples are stored: (band, begin, end)."""
    for band in job.bands(BAND_PIXELS):
        for begin, end in ranges(job.spp, stored_spp(job)):
            yield band, begin, end
        dr.sync_thread()


def register_spp(job: Job) -> int:
    """Samples per pixel of a pass that stores nothing."""
    return max(
        1, PASS_SAMPLES // min(job.width * job.height, REGISTER_BAND_PIXELS if job.film.filters else MAX_SAMPLES)
    )


def stored_spp(job: Job) -> int:
    """Samples per pixel that a pass over a band may store."""
    return max(1, STORED_SAMPLES // min(job.width * job.height, max(BAND_PIXELS, job.width)))


def ranges(spp: int, size: int) -> Iterator[tuple[int, int]]:
    """Split 0 .. spp into passes of at most `size`.

    A pass begins when the one before has finished: kernels are launched asynchronously, and what all
    of them need together must not pile up in memory.
    """
    for begin in range(0, spp, size):
        if begin:
            dr.sync_thread()
        yield begin, min(begin + size, spp)


def report(job: Job, done: int) -> None:
    """Tell the caller's progress function; waits for the kernel, so that the number is true."""
    if job.progress is not None:
        dr.sync_thread()
        job.progress(done, job.samples)


def picture(channels: list[Float], width: int, height: int) -> TensorXf:
    """Finished channels, one array each, as an image. They must be evaluated."""
    flat, count = dr.empty(Float, width * height * len(channels)), dr.opaque(UInt32, len(channels))
    first = dr.arange(UInt32, width * height) * count
    for i, channel in enumerate(channels):
        dr.scatter(flat, channel, first + i)
    return TensorXf(flat, shape=(height, width, len(channels)))


def develop(job: Job, sums: list[Float], weight: Float) -> TensorXf:
    """Weighted sums over weights, cropped: the image. `sums` must be evaluated."""
    border, (width, height), count = job.film.border, job.film.crop_size, len(sums)
    columns, first = dr.opaque(UInt32, width), dr.opaque(UInt32, border)
    # One lane per number of the image: one small kernel, whatever the number of channels.
    index = dr.arange(UInt32, width * height * count)
    pixel = index // count
    channel, row = index - pixel * count, pixel // columns
    source = dr.fma(row + first, job.width_value, pixel - row * columns + first)
    value = dr.gather(Float, sums[0], source)
    for c in range(1, count):
        value = dr.select(channel == c, dr.gather(Float, sums[c], source, channel == c), value)
    if dr.width(weight) > 1:
        weight = dr.gather(Float, weight, source)
    pixels = value / dr.select(weight == 0, 1, weight)
    dr.eval(pixels)
    return TensorXf(pixels, shape=(height, width, count))
