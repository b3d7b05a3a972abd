"""From stored samples to pixels, exactly and repeatably: without atomic additions.

Every sample adds w L and w, w = f(dx) f(dy), to all pixels within the filter's radius. Adding
from the samples' side would need atomics, whose order (and so rounding) changes from run to
run. Instead a lane keeps sums of its own for all targets in its reach, and afterwards every
pixel collects the sums that its neighbourhood holds for it, in a fixed order. There are three ways
to cut the work, with the same interface:

* *By pixels*: a lane is a source pixel with taps x taps sums. Each sample is read once.
* *By rows*: a lane is a target column in a source row with one sum per target row. Samples are
  read once per column in reach, but `taps` times fewer sums are needed: for many channels.
* *By targets*: a lane is a target pixel with one sum, and loops over all samples in reach: for filters
  so wide that kernels can't unroll their taps (`djpt.rendering.schedules.reconstruction`).

Film offsets aren't stored: they are the first two numbers of each sample's stream. The order
of additions depends on the image alone, not on passes or bands.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import drjit as dr

from djpt.jit.kernels import while_loop
from djpt.jit.types import Bool, Float, Int32, Point2f, TensorXf, UInt32
from djpt.rendering.schedules.job import Band, Job
from djpt.rfilters.base import ReconstructionFilter, is_wide, tap_centers

__all__ = [
    "MAX_SUMS",
    "Read",
    "Rows",
    "Spread",
    "Summed",
    "add_box",
    "add_by_pixels",
    "add_samples",
    "add_taps",
    "by_pixels",
    "collect",
    "collected",
    "image_of_rows",
    "picture",
    "sample_adjoints",
    "strips_of_rows",
]

Sums = list[Float]
"""The lanes' sums for one band: one array per tap and channel; the last channel is the weight."""

MAX_SUMS = 128
"""Sums per lane up to which working by pixels is faster; more don't stay near the registers."""


def by_pixels(job: Job, channels: int) -> bool:
    """True if working by pixels is faster for an image of `channels` channels, the weight included."""
    return job.film.taps**2 * channels <= MAX_SUMS


def add_samples(job: Job, band: Band, samples: list[Float], begin: int, end: int, sums: Sums | None) -> Sums:
    """Add the samples begin <= k < end of a band (per channel [k - begin][pixel]) to the lanes' sums."""
    if is_wide(job.film.taps):
        add = add_to_targets
    else:
        add = add_by_pixels if by_pixels(job, len(samples) + 1) else add_by_rows
    return add(job, band, samples, begin, end, sums)


@dataclass
class Rows:
    """Some rows of the grid and their sums: one array per channel, row by row. With a filter the last is the weight."""

    first_row: int
    count: int
    sums: list[Float]


Spread = Callable[[Job, Band, Sums, Rows], Sums]
"""Adds a finished band's sums to those of the rows in its reach.

Bands must come top to bottom: every pixel then collects its source rows in that order.
"""


def collected(
    job: Job, bands: Iterable[tuple[Band, Sums]], channels: int, spread: Spread | None = None
) -> Iterator[Rows]:
    """The pixels' weighted sums, from those that the lanes of all bands, top to bottom, hold for them.

    Rows are given as soon as no further band reaches them. `channels` includes the weight. `spread` reads the lanes'
    sums, in the layout of `add_samples` if None.
    """
    if spread is None:
        spread = way_to_spread(job, channels)
    reach, open_rows = job.film.taps // 2, None
    for band, sums in bands:
        reached = started(job, band, open_rows, channels)
        open_rows = replace(reached, sums=spread(job, band, sums, reached))
        below = band.first_row + band.rows
        finished = (job.height if below == job.height else below - reach) - open_rows.first_row
        if finished > 0:
            yield replace(open_rows, count=finished)


def way_to_spread(job: Job, channels: int) -> Spread:
    """The function that reads the sums of `add_samples`."""
    if is_wide(job.film.taps):
        return spread_from_targets
    return spread_from_pixels if by_pixels(job, channels) else spread_from_rows


def started(job: Job, band: Band, above: Rows | None, channels: int) -> Rows:
    """The rows that a band reaches, with what the bands above have added to them."""
    reached = reached_rows(job, band)
    first, count = reached.first_row, reached.rows
    pixels = count * job.width
    if above is None:
        return Rows(first, count, [dr.opaque(Float, 0, pixels) for _ in range(channels)])
    slot = dr.arange(UInt32, pixels) + dr.opaque(UInt32, (first - above.first_row) * job.width)
    there = slot < dr.opaque(UInt32, above.count * job.width)
    sums = [dr.gather(Float, channel, slot, there) for channel in above.sums]
    dr.eval(sums)
    return Rows(first, count, sums)


def pixels_of(job: Job, band: Band) -> tuple[UInt32, Int32, Int32, Point2f]:
    """A lane per pixel of a band: its number, column and row in the grid, and its corner on the film."""
    pixel = dr.arange(UInt32, band.rows * job.width) + dr.opaque(UInt32, band.first_row * job.width)
    width = Int32(job.width_value)
    row = Int32(pixel) // width
    column = Int32(pixel) - row * width
    return pixel, column, row, job.on_film(Float(column), Float(row))


# ---- by pixels ----------------------------------------------------------------------------


def add_by_pixels(job: Job, band: Band, samples: list[Float], begin: int, end: int, sums: Sums | None) -> Sums:
    """Add samples to `Sums` with the layout [(row tap * taps + column tap) * (channels + 1) + channel]."""
    taps, count = job.film.taps, dr.opaque(UInt32, end - begin)
    pixel, _, _, corner = pixels_of(job, band)
    lanes = dr.width(pixel)
    lane, size, first = dr.arange(UInt32, lanes), dr.opaque(UInt32, lanes), dr.opaque(UInt32, begin)
    channels = len(samples) + 1
    if sums is None:
        sums = [dr.opaque(Float, 0, lanes) for _ in range(taps * taps * channels)]

    def body(k: UInt32, sums: Sums) -> tuple[UInt32, Sums]:
        slot = dr.fma(k, size, lane)
        values = [dr.gather(Float, s, slot) for s in samples]
        return k + 1, add_taps(job, corner, job.film_offset(pixel, k + first), values, Float(1), sums)

    _, result = while_loop((dr.zeros(UInt32, lanes), sums), lambda k, s: k < count, body, label="film pixels")
    dr.eval(result)
    return result


def add_taps(job: Job, corner: Point2f, offset: Point2f, values: list[Float], factor: Float, sums: Sums) -> Sums:
    """Add one sample of a pixel to all sums in its reach, its weights times `factor`."""
    taps, channels = job.film.taps, len(values) + 1
    wx, wy = tap_weights(job, corner, offset)
    result = list(sums)
    for i in range(taps):
        weight = wx[i] * factor
        column = [v * weight for v in values] + [weight]
        for j in range(taps):
            for c in range(channels):
                at = (j * taps + i) * channels + c
                result[at] = dr.fma(column[c], wy[j], result[at])
    return result


def tap_weights(job: Job, corner: Point2f, offset: Point2f) -> tuple[list[Float], list[Float]]:
    """Weights of a sample for the columns and rows in its reach; `corner` is the corner of its pixel."""
    # Distances come from rounded film positions, as in Mitsuba: in the filter's tail the rounding shows.
    position = corner + offset
    taps, weight = job.film.taps, job.film.rfilter().eval
    centers = tap_centers(taps)
    return (
        [weight(corner.x + c - position.x) for c in centers],
        [weight(corner.y + c - position.y) for c in centers],
    )


def spread_from_pixels(job: Job, band: Band, sums: Sums, rows_in_reach: Rows) -> Sums:
    """Collect, for each pixel, one sum of every source pixel around it, from each of the source's lanes."""
    taps, channels = job.film.taps, len(rows_in_reach.sums)

    def read(row: int) -> Read:
        of_row = sums[row * taps * channels : (row + 1) * taps * channels]

        def tap(lane: UInt32, column: int, active: Bool) -> Sums:
            return [dr.gather(Float, of_row[column * channels + c], lane, active) for c in range(channels)]

        return tap

    return collect(job, band, dr.width(sums[0]), read, rows_in_reach)


Read = Callable[[UInt32, int, Bool], Sums]
"""Reads the sums of a lane for a column tap, where active: one number per channel."""


def collect(job: Job, band: Band, lanes: int, read: Callable[[int], Read], rows_in_reach: Rows) -> Sums:
    """Add to each pixel in a band's reach what the `lanes` of the band's pixels around it hold for it.

    The lanes of a pixel stand side by side.
    `read` gives how the sums for a row tap are read. All row taps have the same kernel, which is soon compiled; where
    it is launched again and again, one kernel for all of them is faster.
    """
    image = rows_in_reach.sums
    for j in reversed(range(job.film.taps)):
        image = collect_row(job, band, lanes, read(j), j - job.film.taps // 2, rows_in_reach, image)
        if not job.repeated:
            dr.eval(image)
    dr.eval(image)
    return image


def collect_row(job: Job, band: Band, lanes: int, read: Read, below: int, place: Rows, image: Sums) -> Sums:
    """Add what the source pixels hold for the pixels `below` them by a number of rows, at the place of `image`."""
    taps, pixels = job.film.taps, band.rows * job.width
    _, column, row, _ = pixels_of(job, Band(place.first_row, place.count))
    width, rows = Int32(job.width_value), dr.opaque(Int32, band.rows)
    count = dr.opaque(UInt32, lanes // pixels)
    y = row - dr.opaque(Int32, below + band.first_row)

    def body(g: UInt32, image: Sums) -> tuple[UInt32, Sums]:
        result = list(image)
        for i in reversed(range(taps)):
            x = column - (i - taps // 2)
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < rows)
            parts = read(dr.fma(UInt32(y * width + x), count, g), i, inside)
            result = [total + part for total, part in zip(result, parts, strict=True)]
        return g + 1, result

    start = dr.zeros(UInt32, dr.width(column))
    _, result = while_loop((start, list(image)), lambda g, image: g < count, body, label="film spread")
    return result


# ---- by rows ------------------------------------------------------------------------------


def add_by_rows(job: Job, band: Band, samples: list[Float], begin: int, end: int, sums: Sums | None) -> Sums:
    """Add samples to `Sums` with the layout [row tap * (channels + 1) + channel]."""
    taps, count = job.film.taps, dr.opaque(UInt32, end - begin)
    reach, channels, weight = taps // 2, len(samples) + 1, job.film.rfilter().eval
    _, column, row, corner = pixels_of(job, band)
    lanes = dr.width(column)
    size, first, width = dr.opaque(UInt32, lanes), dr.opaque(UInt32, begin), Int32(job.width_value)
    first_pixel = dr.opaque(Int32, band.first_row * job.width)
    center = corner + 0.5
    if sums is None:
        sums = [dr.opaque(Float, 0, lanes) for _ in range(taps * channels)]

    def body(k: UInt32, sums: Sums) -> tuple[UInt32, Sums]:
        sums = list(sums)
        for i in range(taps):
            source_column = column + (i - reach)
            inside = (source_column >= 0) & (source_column < width)
            source = row * width + source_column
            offset = job.film_offset(UInt32(source), k + first)
            position = job.on_film(Float(source_column), Float(row)) + offset
            wx = dr.select(inside, weight(center.x - position.x), 0)
            slot = dr.fma(k, size, UInt32(source - first_pixel))
            values = [dr.gather(Float, s, slot, inside) * wx for s in samples] + [wx]
            for j in range(taps):
                wy = weight(center.y + (j - reach) - position.y)
                for c, value in enumerate(values):
                    at = j * channels + c
                    sums[at] = dr.fma(value, wy, sums[at])
        return k + 1, sums

    _, result = while_loop((dr.zeros(UInt32, lanes), sums), lambda k, s: k < count, body, label="film rows")
    dr.eval(result)
    return result


def spread_from_rows(job: Job, band: Band, sums: Sums, rows_in_reach: Rows) -> Sums:
    """Collect, for each pixel, one sum of every source row around it, at its own column."""
    taps, channels = job.film.taps, len(rows_in_reach.sums)
    _, column, row, _ = pixels_of(job, Band(rows_in_reach.first_row, rows_in_reach.count))
    width, first, rows = Int32(job.width_value), dr.opaque(Int32, band.first_row), dr.opaque(Int32, band.rows)
    result = list(rows_in_reach.sums)
    for j in reversed(range(taps)):
        source = row - (j - taps // 2) - first
        inside = (source >= 0) & (source < rows)
        slot = UInt32(source * width + column)
        for c in range(channels):
            result[c] = result[c] + dr.gather(Float, sums[j * channels + c], slot, inside)
    dr.eval(result)
    return result


# ---- by targets ---------------------------------------------------------------------------


def spread_from_targets(job: Job, band: Band, sums: Sums, rows_in_reach: Rows) -> Sums:
    """Add the sums that the pixels in reach have collected themselves."""
    result = [total + part for total, part in zip(rows_in_reach.sums, sums, strict=True)]
    dr.eval(result)
    return result


# ---- without a filter, and backwards ----------------------------------------------------------


def add_box(job: Job, band: Band, samples: list[Float], begin: int, end: int, sums: list[Float] | None) -> list[Float]:
    """Add up the samples of each pixel in order, without weights: all that the box filter needs."""
    pixels = band.rows * job.width
    lane = dr.arange(UInt32, pixels)
    size, count = dr.opaque(UInt32, pixels), dr.opaque(UInt32, end - begin)
    if sums is None:
        sums = [dr.opaque(Float, 0, pixels) for _ in samples]

    def body(k: UInt32, sums: list[Float]) -> tuple[UInt32, list[Float]]:
        slot = dr.fma(k, size, lane)
        return k + 1, [s + dr.gather(Float, b, slot) for s, b in zip(sums, samples, strict=True)]

    _, result = while_loop((dr.zeros(UInt32, pixels), sums), lambda k, s: k < count, body, label="film box")
    dr.eval(result)
    return result


def sample_adjoints(job: Job, band: Band, image: list[Float], begin: int, end: int) -> list[Float]:
    """The transpose of the reconstruction: derivatives with respect to the samples begin <= k < end of a band.

    `image` holds the derivatives with respect to the weighted sums: those with respect to the pixels,
    divided by the sum of weights. delta_s = sum over pixels j of w_j(s) image_j. Layout [k - begin][pixel] per channel.
    """
    taps = job.film.taps
    if is_wide(taps):
        return gather_from_targets(job, band, image, begin, end)
    reach = taps // 2
    pixel, column, row, corner = pixels_of(job, band)
    pixels = dr.width(pixel)
    lane, width, height = dr.arange(UInt32, pixels), Int32(job.width_value), dr.opaque(Int32, job.height)
    size, count, first = (dr.opaque(UInt32, n) for n in (pixels, end - begin, begin))

    around = []
    for j in range(taps):
        for i in range(taps):
            x, y = column + (i - reach), row + (j - reach)
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            around.append([dr.gather(Float, channel, UInt32(y * width + x), inside) for channel in image])
    buffers = [dr.empty(Float, pixels * (end - begin)) for _ in image]

    def body(k: UInt32) -> tuple[UInt32]:
        wx, wy = tap_weights(job, corner, job.film_offset(pixel, k + first))
        for c, buffer in enumerate(buffers):
            total = Float(0)
            for j in range(taps):
                in_row = Float(0)
                for i in range(taps):
                    in_row = dr.fma(wx[i], around[j * taps + i][c], in_row)
                total = dr.fma(wy[j], in_row, total)
            dr.scatter(buffer, total, dr.fma(k, size, lane))
        return (k + 1,)

    while_loop((dr.zeros(UInt32, pixels),), lambda k: k < count, body, label="film adjoint")
    dr.eval(buffers)
    return buffers


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
    """The image (height, width, channels) from sums, top to bottom; where they end, the rest is black.

    A large image is computed in bands of rows. Each is developed as soon as no further sample reaches it, so that sums
    are only held for the rows that are being computed.
    """
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


def reached_rows(job: Job, band: Band) -> Band:
    """The rows of the grid that samples of a band reach."""
    reach = job.film.taps // 2
    first, end = max(0, band.first_row - reach), min(job.height, band.first_row + band.rows + reach)
    return Band(first, end - first)


@dataclasses.dataclass
class Tap:
    """A place in reach of a lane's pixel, visited by a loop: the offset from it in columns and rows."""

    x: Int32
    y: Int32

    def after(self, reach: Int32) -> Tap:
        """The next place, row by row; at the end the first one of a row below all."""
        at_end = self.x == reach
        return Tap(dr.select(at_end, -reach, self.x + 1), dr.select(at_end, self.y + 1, self.y))


class Places:
    """Lanes on the pixels of some rows of the grid, and where samples of other pixels lie."""

    def __init__(self, job: Job, rows: Band) -> None:
        self._job = job
        self.pixel = dr.arange(UInt32, rows.rows * job.width) + dr.opaque(UInt32, rows.first_row * job.width)
        self._width = Int32(job.width_value)
        self.row = Int32(self.pixel) // self._width
        self.column = Int32(self.pixel) - self.row * self._width
        self.reach = dr.opaque(Int32, job.film.taps // 2)

    def first_tap(self) -> Tap:
        """The first place in reach."""
        lanes = dr.width(self.pixel)
        start = dr.zeros(Int32, lanes) - self.reach
        return Tap(start, Int32(start))

    def at(self, tap: Tap, rows: Band) -> tuple[UInt32, Bool]:
        """The pixel at a tap, numbered from the first of `rows` on, and whether it is one of these rows."""
        x, y = self.column + tap.x, self.row + tap.y - dr.opaque(Int32, rows.first_row)
        inside = (x >= 0) & (x < self._width) & (y >= 0) & (y < dr.opaque(Int32, rows.rows))
        return UInt32(y * self._width + x), inside

    def corner(self) -> Point2f:
        """The corners of the lanes' pixels on the film."""
        return self._job.on_film(Float(self.column), Float(self.row))


def weight_between(rfilter: ReconstructionFilter, centre: Point2f, position: Point2f) -> Float:
    """The weight of a sample at a position on the film for the pixel with a centre."""
    product: Float = rfilter.eval(centre.x - position.x) * rfilter.eval(centre.y - position.y)
    return product


def add_to_targets(
    job: Job, band: Band, samples: list[Float], begin: int, end: int, sums: list[Float] | None
) -> list[Float]:
    """Add the samples begin <= k < end of a band to the sums of the pixels in reach, the weight's sum being the last.

    For wide filters: loops over the taps, which kernels for narrow ones unroll. A lane is a target pixel. It visits all
    samples in reach, so there is one sum per channel, whatever the filter's width. The time grows with the filter's
    area: a pixel of a film with n taps along an axis reads n^2 samples for each one of its own.

    The samples have the layout [k - begin][pixel] per channel, the sums that of `reached_rows`.
    """
    rfilter, places, rows = job.film.rfilter(), Places(job, reached_rows(job, band)), band
    positions = positions_of(job, band, begin, end)
    lanes, pixels = dr.width(places.pixel), band.rows * job.width
    size, count = dr.opaque(UInt32, pixels), dr.opaque(UInt32, end - begin)
    centre = places.corner() + 0.5
    if sums is None:
        sums = [dr.opaque(Float, 0, lanes) for _ in range(len(samples) + 1)]

    def body(k: UInt32, tap: Tap, sums: list[Float]) -> tuple[UInt32, Tap, list[Float]]:
        source, inside = places.at(tap, rows)
        slot = dr.fma(k, size, source)
        position = dr.gather(Point2f, positions, slot, inside)
        weight = dr.select(inside, weight_between(rfilter, centre, position), 0)
        values = [dr.gather(Float, s, slot, inside) for s in samples]
        added = [dr.fma(value, weight, total) for value, total in zip([*values, Float(1)], sums, strict=True)]
        following = tap.after(places.reach)
        ended = following.y > places.reach
        following.y = dr.select(ended, -places.reach, following.y)
        return dr.select(ended, k + 1, k), following, added

    start = (dr.zeros(UInt32, lanes), places.first_tap(), list(sums))
    *_, result = while_loop(start, lambda k, tap, sums: k < count, body, label="wide filter")
    dr.eval(result)
    return result


def positions_of(job: Job, band: Band, begin: int, end: int) -> Float:
    """The places on the film of the samples of a band, x and y by turns: [k - begin][pixel]."""
    places, first = Places(job, band), dr.opaque(UInt32, begin)
    corner, lanes = places.corner(), dr.width(places.pixel)
    lane, size, count = dr.arange(UInt32, lanes), dr.opaque(UInt32, lanes), dr.opaque(UInt32, end - begin)
    positions = dr.empty(Float, 2 * lanes * (end - begin))

    def body(k: UInt32) -> tuple[UInt32]:
        dr.scatter(positions, corner + job.film_offset(places.pixel, k + first), dr.fma(k, size, lane))
        return (k + 1,)

    while_loop((dr.zeros(UInt32, lanes),), lambda k: k < count, body, label="wide filter places")
    dr.eval(positions)
    return positions


def gather_from_targets(job: Job, band: Band, image: list[Float], begin: int, end: int) -> list[Float]:
    """The transpose of `add_to_targets`: for each sample the sum of what the pixels in reach hold, by its weights."""
    rfilter, places, whole = job.film.rfilter(), Places(job, band), Band(0, job.height)
    corner, lanes = places.corner(), dr.width(places.pixel)
    lane, size, first = dr.arange(UInt32, lanes), dr.opaque(UInt32, lanes), dr.opaque(UInt32, begin)
    count = dr.opaque(UInt32, end - begin)
    buffers = [dr.empty(Float, lanes * (end - begin)) for _ in image]

    def body(k: UInt32) -> tuple[UInt32]:
        position = corner + job.film_offset(places.pixel, k + first)

        def visit(tap: Tap, totals: list[Float]) -> tuple[Tap, list[Float]]:
            target, inside = places.at(tap, whole)
            centre = corner + Point2f(Float(tap.x) + 0.5, Float(tap.y) + 0.5)
            weight = dr.select(inside, weight_between(rfilter, centre, position), 0)
            held = [dr.gather(Float, channel, target, inside) for channel in image]
            return tap.after(places.reach), [dr.fma(h, weight, t) for h, t in zip(held, totals, strict=True)]

        start = (places.first_tap(), [dr.zeros(Float, lanes) for _ in image])
        _, totals = while_loop(start, lambda tap, totals: tap.y <= places.reach, visit, label="wide filter taps")
        for buffer, total in zip(buffers, totals, strict=True):
            dr.scatter(buffer, total, dr.fma(k, size, lane))
        return (k + 1,)

    while_loop((dr.zeros(UInt32, lanes),), lambda k: k < count, body, label="wide filter adjoint")
    dr.eval(buffers)
    return buffers
