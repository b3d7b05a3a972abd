"""Sums of a film in memory, to which kernels add samples by calls of a compiled function.

Loop state of a hundred sums doesn't fit into registers: LLVM writes all of them to the stack and reads them
again at every turn, and all lanes of a packet add zeros when one has finished a sample. The function adds
only the samples that there are, each with a few vector instructions.

The sums of a lane stand side by side, in the order [row tap][column tap][channel], the weight being the last channel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import numpy as np

from djpt.description.plugin import is_plain
from djpt.description.properties import Properties
from djpt.films.base import Film
from djpt.geometry.ray_queries import asked_for
from djpt.integrators.base import Integrator
from djpt.jit.kernels import power_of_two
from djpt.jit.llvm import arithmetic
from djpt.jit.llvm.arithmetic import fma
from djpt.jit.llvm.calls import Code, call, reason_against
from djpt.jit.llvm.compiler import compiled
from djpt.jit.llvm.ir import F32, I32, I64, PTR, Function, Module, Type, Value, vector
from djpt.jit.llvm.lanes import lane_count
from djpt.jit.types import ArrayXf, Bool, Float, Point2f, UInt32
from djpt.rendering.schedules.job import Job, image_channels
from djpt.rendering.schedules.reconstruction import Read, by_pixels
from djpt.rfilters.base import ReconstructionFilter, is_wide, tap_centers
from djpt.rfilters.tent import Tent

__all__ = [
    "CHANNELS",
    "CalledSums",
    "Taps",
    "holds_sums",
    "prepare_function",
    "prepare_sums",
    "reader",
    "tap_function",
    "usable",
]

ADD_SAMPLES = "add_samples"
"""The function's name."""

POSITION, CORNER, CHANNELS, LANE = (0, 1), (2, 3), (4, 5, 6, 7, 10, 11), 9
"""The arrays of a packet: film positions of samples, corners of their pixels, channels, numbers of lanes."""

ROW = 8
"""The numbers that one instruction adds."""


@dataclass(frozen=True)
class Taps:
    """The sums that a sample is added to: those of `count` x `count` pixels around its own, by channel."""

    count: int
    channels: int
    """Channels of samples; the sums have one more, the weight."""

    @property
    def sums(self) -> int:
        """The sums of a lane."""
        return self.count**2 * (self.channels + 1)


def tap_function(taps: Taps, rfilter: ReconstructionFilter, width: int) -> str:
    """The function for packets of `width` lanes."""
    module = Module()
    parameters = [("valid", PTR), ("sums", PTR), ("context", PTR), ("samples", PTR)]
    with module.function(ADD_SAMPLES, parameters) as f:
        valid, sums, _, samples = f.parameters
        with f.each(0, width) as lane, f.when(f.load(I32, valid.at(lane * 4)) != 0):

            def word(array: int, type: Type = F32, lane: Value = lane) -> Value:
                return f.load(type, samples.at((lane + array * width) * 4))

            of_columns, of_rows = (
                weights(f, taps, rfilter, word(corner), word(position))
                for corner, position in zip(CORNER, POSITION, strict=True)
            )
            own = sums.at(word(LANE, I32).to(I64) * (4 * taps.sums))
            add_rows(f, taps, own, products(f, taps, of_columns, [word(c) for c in CHANNELS[: taps.channels]]), of_rows)
    return module.text()


def weights(f: Function, taps: Taps, rfilter: ReconstructionFilter, corner: Value, position: Value) -> Value:
    """The weights of a sample for the columns, or for the rows, in its reach."""
    lanes = power_of_two(taps.count)
    centers = [*tap_centers(taps.count), *[0.0] * (lanes - taps.count)]
    centered = corner.spread(lanes) + f.constants(F32, centers)
    weight: Value = rfilter.formula(arithmetic, centered - position.spread(lanes))
    return weight


def products(f: Function, taps: Taps, of_columns: Value, channels: list[Value]) -> list[Value]:
    """The products of weights and channels for a row of taps, in pieces of `ROW` numbers or a few less."""
    size = power_of_two(taps.channels + 1)
    values = f.constant(vector(F32, size), 1.0)
    for c, channel in enumerate(channels):
        values = f.emit(f"insertelement {values}, {channel}, i32 {c}", values.type)
    numbers = [divmod(k, taps.channels + 1) for k in range(taps.count * (taps.channels + 1))]
    return [
        of_columns.shuffled([column for column, _ in piece]) * values.shuffled([channel for _, channel in piece])
        for piece in pieces(numbers)
    ]


def add_rows(f: Function, taps: Taps, own: Value, products: list[Value], of_rows: Value) -> None:
    """Add the products, weighted row by row, to a lane's sums."""
    address = 0
    for j in range(taps.count):
        weight = of_rows.lane(j)
        for product in products:
            place = own.at(address)
            lanes = product.type.lanes or 1
            f.store(fma(product, weight.spread(lanes), f.load(product.type, place)), place)
            address += 4 * lanes


def pieces(items: list[Any]) -> list[list[Any]]:
    """A list in pieces whose lengths are powers of two, `ROW` at most."""
    result, start = [], 0
    while start < len(items):
        size = min(ROW, 1 << ((len(items) - start).bit_length() - 1))
        result.append(items[start : start + size])
        start += size
    return result


class CalledSums:
    """The sums of some lanes; the lanes of a kernel have the same numbers."""

    def __init__(self, taps: Taps, rfilter: ReconstructionFilter, lanes: int, memory: Float | None = None) -> None:
        """Begin with the sums in `memory`, which is written to, or with zeros."""
        self.memory = dr.opaque(Float, 0, lanes * taps.sums) if memory is None else memory
        self._code = function(taps, rfilter)
        self._lane, self._lanes = dr.arange(UInt32, lanes), dr.opaque(UInt32, lanes)

    def add(
        self, corner: Point2f, offset: Point2f, channels: list[Float], active: Bool, slot: UInt32 | None = None
    ) -> Bool:
        """Add a sample of each active lane; return where there was one.

        `offset` is the sample's place on its pixel, whose corner has the film position `corner`. `slot` says whose
        sums it is added to: by default those of its lane. No two lanes may add to the same ones. The call takes place
        only if the result is used.
        """
        if slot is None:
            slot = self._lane
        # The last packet may have lanes beyond the last one.
        active = active & (slot < self._lanes)
        # Distances come from rounded film positions, as in Mitsuba: in the filter's tail the rounding shows.
        position = corner + offset
        unused, end = Float(0), Float(1)
        words: list[Any] = [*channels, *[unused] * (len(CHANNELS) - len(channels))]
        last = [dr.reinterpret_array(UInt32, word) for word in words[4:]]
        floats = [position.x, position.y, corner.x, corner.y, *words[:4], end]
        inputs = [Bool(False), active, *floats, slot, *last]
        # The function leaves the end of the "ray" as it is, so nothing is ever blocked.
        (blocked,) = call(self._code, self.memory, [dr.detach(x) for x in inputs], [Bool(False)], any_hit=True)
        taken: Bool = active & ~blocked
        return taken


def reader(memory: Float, taps: Taps, row: int) -> Read:
    """Reads the sums of lanes for a row tap, the weights' included."""
    channels = taps.channels + 1
    first, of_lane = dr.opaque(UInt32, row * taps.count), taps.count**2

    def tap(lane: UInt32, column: int, active: Bool) -> list[Float]:
        index = dr.fma(lane, of_lane, first) + column
        sums: Any = dr.gather(ArrayXf, memory, index, active, shape=(channels, dr.width(lane)))
        return list(sums)

    return tap


def prepare_sums(film: Film, integrator: Integrator) -> None:
    """Compile the function that adds an integrator's samples to a film, if they are added by calls."""
    taps = Taps(film.taps, len(image_channels(film, integrator)))
    if film.filters and {"flat", "wave"} & {*integrator.schedules} and usable(taps, film.rfilter()):
        prepare_function(taps, film.rfilter())


def prepare_function(taps: Taps, rfilter: ReconstructionFilter) -> None:
    """Compile the function that adds samples with a filter's weights, which frozen functions can't."""
    function(taps, rfilter)


_functions: dict[Any, Code] = {}
"""The functions that have been compiled, by what they are written from."""


def function(taps: Taps, rfilter: ReconstructionFilter) -> Code:
    """The function that adds samples to the pixels around their own, compiled at the first call."""
    width = lane_count()
    attributes = tuple((name, value) for name, value in vars(rfilter).items() if name != "_id")
    # A filter of a script may have attributes that can't be compared.
    key: Any = (taps, width, type(rfilter), attributes) if is_plain(attributes) else tap_function(taps, rfilter, width)
    if key not in _functions:
        text = tap_function(taps, rfilter, width)
        _functions[key] = Code.at(compiled(text, (ADD_SAMPLES,))[ADD_SAMPLES])
    return _functions[key]


def usable(taps: Taps, rfilter: ReconstructionFilter) -> bool:
    """Whether samples can be added by calls."""
    return (
        rfilter.has_formula
        and not is_wide(taps.count)
        and taps.channels <= len(CHANNELS)
        and asked_for() != "steps"
        and works()
    )


def holds_sums(job: Job) -> bool:
    """Whether lanes can hold the sums of all pixels that their samples reach, so that no samples are stored."""
    film, channels = job.film, job.channel_count()
    return not film.filters or usable(Taps(film.taps, channels), film.rfilter()) or by_pixels(job, channels + 1)


@cache
def works() -> bool:
    """Whether calls add what they are to add."""
    return reason_against(proved, "samples of known sums got others") is None


def proved() -> bool:
    """Whether samples whose sums are known are added up to them."""
    lanes, skipped, taps, tent = 2 * lane_count() + 3, 1, Taps(3, 1), Tent(Properties("rfilter", "tent", {}))
    sums = CalledSums(taps, tent, lanes)
    lane = dr.arange(UInt32, lanes)
    corner = Point2f(Float(lane), Float(2 * lane))
    taken = sums.add(corner, Point2f(0.25, 0.5), [Float(lane) + 1], lane != skipped)
    dr.eval(taken)
    weights = np.outer([0, 1, 0], [0.25, 0.75, 0])
    expected = np.multiply.outer(np.arange(1, lanes + 1), weights)[..., None]
    expected = np.concatenate([expected, np.broadcast_to(weights[..., None], expected.shape)], axis=-1)
    expected[skipped] = 0
    return bool(np.allclose(np.array(sums.memory).reshape(expected.shape), expected))
