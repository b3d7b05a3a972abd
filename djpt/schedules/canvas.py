"""The memory of a finished image, which is filled from top to bottom.

A large image is computed in bands of rows. Each is developed into its place as soon as no further sample reaches it, so
that sums are only held for the rows that are being computed.
"""

from __future__ import annotations

import drjit as dr

from djpt.schedules.job import Job
from djpt.schedules.reconstruction import Rows
from djpt.types import Float, TensorXf, UInt32

__all__ = ["Canvas", "picture"]


class Canvas:
    """The pixels of a job's image."""

    def __init__(self, job: Job, channels: int) -> None:
        self._job, self._channels = job, channels
        width, height = job.film.crop_size()
        self._memory = dr.empty(Float, width * height * channels)

    def develop(self, rows: Rows, weight: Float) -> None:
        """Write weighted sums (evaluated) over `weight`: one number for all pixels, or an array like the sums.

        Rows of the border are left out.
        """
        job, count = self._job, self._channels
        border, (width, height) = job.film.border, job.film.crop_size()
        top, end = max(rows.first_row, border), min(rows.first_row + rows.count, border + height)
        if end <= top:
            return
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
        if dr.width(weight) > 1:
            weight = dr.gather(Float, weight, source)
        first = dr.opaque(UInt32, (top - border) * width * count)
        dr.scatter(self._memory, value / dr.select(weight == 0, 1, weight), first + index)
        dr.eval(self._memory)

    def image(self) -> TensorXf:
        """The image (height, width, channels)."""
        width, height = self._job.film.crop_size()
        return TensorXf(self._memory, shape=(height, width, self._channels))


def picture(channels: list[Float], width: int, height: int) -> TensorXf:
    """Finished channels, one array each, as an image. They must be evaluated."""
    flat, count = dr.empty(Float, width * height * len(channels)), dr.opaque(UInt32, len(channels))
    first = dr.arange(UInt32, width * height) * count
    for i, channel in enumerate(channels):
        dr.scatter(flat, channel, first + i)
    return TensorXf(flat, shape=(height, width, len(channels)))
