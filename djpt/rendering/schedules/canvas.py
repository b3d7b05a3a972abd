"""Finished pixels: of a whole image, which is filled from top to bottom, or of strips of it.

A large image is computed in bands of rows. Each is developed as soon as no further sample reaches it, so
that sums are only held for the rows that are being computed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import drjit as dr

from djpt.jit.types import Float, TensorXf, UInt32
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.reconstruction import Rows

__all__ = ["Strip", "Summed", "image_of_rows", "picture", "strips_of_rows"]

Summed = tuple[Rows, Float]
"""Rows of weighted sums (evaluated) that no further sample reaches, and their weight: one number, or one per pixel."""


@dataclass
class Strip:
    """Some rows of a finished image."""

    first_row: int
    count: int
    values: Float
    """The numbers of the rows: [row][column][channel]."""


def image_of_rows(job: Job, finished: Iterable[Summed]) -> TensorXf:
    """The image (height, width, channels) from sums, top to bottom; where they end, the rest is black."""
    width, height = job.film.crop_size()
    count, end = job.channel_count(), 0
    memory = dr.empty(Float, width * height * count)
    for strip in strips_of_rows(job, finished):
        index = dr.arange(UInt32, strip.count * width * count)
        dr.scatter(memory, strip.values, dr.opaque(UInt32, strip.first_row * width * count) + index)
        dr.eval(memory)
        end = strip.first_row + strip.count
    if end < height:
        index = dr.arange(UInt32, (height - end) * width * count)
        dr.scatter(memory, Float(0), dr.opaque(UInt32, end * width * count) + index)
    return TensorXf(memory, shape=(height, width, count))


def strips_of_rows(job: Job, finished: Iterable[Summed]) -> Iterator[Strip]:
    """Divide sums by their weights; the values of a strip aren't evaluated. Rows of the border are left out."""
    count = job.channel_count()
    border, (width, height) = job.film.border, job.film.crop_size()
    for rows, weight in finished:
        top, end = max(rows.first_row, border), min(rows.first_row + rows.count, border + height)
        if end <= top:
            continue
        columns, left = dr.opaque(UInt32, width), dr.opaque(UInt32, border)
        # One lane per number of the image: one small kernel, whatever the number of channels.
        index = dr.arange(UInt32, (end - top) * width * count)
        pixel = index // count
        channel, row = index - pixel * count, pixel // columns
        above = dr.opaque(UInt32, top - rows.first_row)
        source = dr.fma(row + above, job.width_value, pixel - row * columns + left)
        value = dr.gather(Float, rows.sums[0], source)
        for c in range(1, count):
            value = dr.select(channel == c, dr.gather(Float, rows.sums[c], source, channel == c), value)
        of_pixel = dr.gather(Float, weight, source) if dr.width(weight) > 1 else weight
        yield Strip(top - border, end - top, value / dr.select(of_pixel == 0, 1, of_pixel))


def picture(channels: list[Float], width: int, height: int) -> TensorXf:
    """Finished channels, one array each, as an image. They must be evaluated."""
    flat, count = dr.empty(Float, width * height * len(channels)), dr.opaque(UInt32, len(channels))
    first = dr.arange(UInt32, width * height) * count
    for i, channel in enumerate(channels):
        dr.scatter(flat, channel, first + i)
    return TensorXf(flat, shape=(height, width, len(channels)))
