"""From stored samples to pixels, exactly and repeatably: without atomic additions.

Every sample adds w L and w, w = f(dx) f(dy), to all pixels within the filter's radius. Adding
from the samples' side would need atomics, whose order (and so rounding) changes from run to
run. Instead the work is split along the two axes:

1. A lane belongs to a target column and a source row. It visits the samples of the row's
   pixels around its column and adds f(dx) f(dy) L to one sum per target row in reach.
2. A pixel adds up the sums that the source rows around it hold for it, top to bottom.

Film offsets aren't stored: they are the first two numbers of each sample's stream.
The order of additions depends on the image alone, not on passes or bands.
"""

from __future__ import annotations

import drjit as dr

from djpt.schedules.job import Band, Job
from djpt.types import Bool, Float, Int32, UInt32

__all__ = ["RowSums", "add_box", "add_rows", "sample_adjoints", "spread"]

RowSums = list[Float]
"""Sums of one band, index row_tap * (channels + 1) + channel; the last channel is the weight."""


def add_rows(job: Job, band: Band, samples: list[Float], begin: int, end: int, sums: RowSums | None) -> RowSums:
    """Step 1 for the samples begin <= k < end of a band, added to `sums`."""
    taps, pixels = job.film.taps, band.rows * job.width
    reach, channels = taps // 2, len(samples)
    lane = dr.arange(UInt32, pixels)
    width = Int32(job.width_value)
    row = Int32(lane) // width
    column = Int32(lane) - row * width
    start_of_row = row * width
    film_row = Float(row + dr.opaque(Int32, band.first_row))
    center, weight = job.on_film(Float(column), film_row) + 0.5, job.film.rfilter.eval
    first_pixel = dr.opaque(UInt32, band.first_row * job.width)
    size, count, first = (dr.opaque(UInt32, n) for n in (pixels, end - begin, begin))
    if sums is None:
        sums = [dr.zeros(Float, pixels) for _ in range(taps * (channels + 1))]

    def body(k: UInt32, sums: RowSums) -> tuple[UInt32, RowSums]:
        sums = list(sums)
        for i in range(taps):
            source_column = column + (i - reach)
            inside = (source_column >= 0) & (source_column < width)
            source = UInt32(start_of_row + source_column)
            offset = job.film_offset(source + first_pixel, k + first)
            # Distances come from rounded film positions, as in Mitsuba: in the kernel's tail the rounding shows.
            position = job.on_film(Float(source_column), film_row) + offset
            wx = dr.select(inside, weight(center.x - position.x), 0)
            slot = dr.fma(k, size, source)
            values = [dr.gather(Float, s, slot, inside) * wx for s in samples] + [wx]
            for j in range(taps):
                wy = weight(center.y + (j - reach) - position.y)
                for c, value in enumerate(values):
                    at = j * (channels + 1) + c
                    sums[at] = dr.fma(value, wy, sums[at])
        return k + 1, sums

    _, result = dr.while_loop((dr.zeros(UInt32, pixels), sums), lambda k, s: k < count, body, label="film rows")
    dr.eval(result)
    return result


def spread(job: Job, band: Band, sums: RowSums, image: list[Float]) -> list[Float]:
    """Step 2: add a finished band to the image (channels and weight, one array each).

    Bands must come top to bottom: every pixel then adds its source rows in that order.
    """
    taps, channels = job.film.taps, len(image)
    reach = taps // 2
    pixel = dr.arange(UInt32, job.width * job.height)
    width = job.width_value
    row = Int32(pixel // width)
    column = pixel - UInt32(row) * width
    first, rows = dr.opaque(Int32, band.first_row), dr.opaque(Int32, band.rows)
    result = list(image)
    for j in reversed(range(taps)):
        source = row - (j - reach) - first
        inside: Bool = (source >= 0) & (source < rows)
        slot = dr.fma(UInt32(source), width, column)
        for c in range(channels):
            result[c] = result[c] + dr.gather(Float, sums[j * channels + c], slot, inside)
    dr.eval(result)
    return result


def add_box(job: Job, band: Band, samples: list[Float], begin: int, end: int, sums: list[Float] | None) -> list[Float]:
    """The box filter's share of both steps: a pixel's own samples in order, no weights."""
    pixels = band.rows * job.width
    lane = dr.arange(UInt32, pixels)
    size, count = dr.opaque(UInt32, pixels), dr.opaque(UInt32, end - begin)
    if sums is None:
        sums = [dr.zeros(Float, pixels) for _ in samples]

    def body(k: UInt32, sums: list[Float]) -> tuple[UInt32, list[Float]]:
        slot = dr.fma(k, size, lane)
        return k + 1, [s + dr.gather(Float, b, slot) for s, b in zip(sums, samples, strict=True)]

    _, result = dr.while_loop((dr.zeros(UInt32, pixels), sums), lambda k, s: k < count, body, label="film box")
    dr.eval(result)
    return result


def sample_adjoints(job: Job, band: Band, image: list[Float], begin: int, end: int) -> list[Float]:
    """The transpose of both steps: derivatives by the samples begin <= k < end of a band.

    `image` holds the derivatives by the weighted sums, that is those by the pixels over the sum
    of weights. delta_s = sum over pixels j of w_j(s) image_j. Layout [k - begin][pixel] per channel.
    """
    taps, pixels = job.film.taps, band.rows * job.width
    reach = taps // 2
    lane = dr.arange(UInt32, pixels)
    pixel = lane + dr.opaque(UInt32, band.first_row * job.width)
    width, height = Int32(job.width_value), dr.opaque(Int32, job.height)
    row = Int32(pixel) // width
    column = Int32(pixel) - row * width
    size, count, first = (dr.opaque(UInt32, n) for n in (pixels, end - begin, begin))

    corner, weight = job.on_film(Float(column), Float(row)), job.film.rfilter.eval
    around = []
    for j in range(taps):
        for i in range(taps):
            x, y = column + (i - reach), row + (j - reach)
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            around.append([dr.gather(Float, channel, UInt32(y * width + x), inside) for channel in image])
    buffers = [dr.empty(Float, pixels * (end - begin)) for _ in image]

    def body(k: UInt32) -> tuple[UInt32]:
        position = corner + job.film_offset(pixel, k + first)
        wx = [weight(corner.x + (i - reach + 0.5) - position.x) for i in range(taps)]
        wy = [weight(corner.y + (j - reach + 0.5) - position.y) for j in range(taps)]
        for c, buffer in enumerate(buffers):
            total = Float(0)
            for j in range(taps):
                in_row = Float(0)
                for i in range(taps):
                    in_row = dr.fma(wx[i], around[j * taps + i][c], in_row)
                total = dr.fma(wy[j], in_row, total)
            dr.scatter(buffer, total, dr.fma(k, size, lane))
        return (k + 1,)

    dr.while_loop((dr.zeros(UInt32, pixels),), lambda k: k < count, body, label="film adjoint")
    dr.eval(buffers)
    return buffers
