"""Reconstruction with wide filters: loops over the taps, which kernels for narrow ones unroll.

A lane is a target pixel. It visits all samples in reach, so there is one sum per channel, whatever the filter's width.
The time grows with the filter's area: a pixel of a film with n taps along an axis reads n^2 samples for each one of
its own.
"""

from __future__ import annotations

import dataclasses

import drjit as dr

from djpt.jit.kernels import while_loop
from djpt.jit.types import Bool, Float, Int32, Point2f, UInt32
from djpt.rendering.schedules.job import Band, Job
from djpt.rfilters.base import ReconstructionFilter

__all__ = ["add_to_targets", "gather_from_targets", "reached_rows"]


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
