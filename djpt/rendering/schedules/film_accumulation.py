"""The addition of samples to sums in memory, as a function in LLVM's language.

Loop state of a hundred sums doesn't fit into registers: LLVM writes all of them to the stack and reads them
again at every turn, and all lanes of a packet add zeros when one has finished a sample. This function adds
only the samples that there are, each with a few vector instructions.

The sums of a lane stand side by side, in the order [row tap][column tap][channel], the weight being the last channel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from djpt.jit.llvm import arithmetic
from djpt.jit.llvm.arithmetic import fma
from djpt.jit.llvm.ir import F32, I32, I64, PTR, Function, Module, Type, Value, vector
from djpt.rfilters.base import ReconstructionFilter, tap_centers

__all__ = ["ADD_SAMPLES", "CHANNELS", "Taps", "tap_function"]

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


def power_of_two(count: int) -> int:
    """The smallest power of two that isn't less."""
    return 1 << (count - 1).bit_length()
