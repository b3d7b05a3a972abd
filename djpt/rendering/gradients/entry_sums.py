"""Sums of the derivatives of tables, entry by entry: the texels of a bitmap, the voxels of a grid.

They are added by Dr.Jit, or by calls of a compiled function (`djpt.rendering.gradients.entry_function`) where kernels
can make some.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any, Protocol

import drjit as dr
import numpy as np

from djpt.dispatch.tables import Buffer
from djpt.geometry.ray_queries import asked_for
from djpt.jit.frozen import recording
from djpt.jit.kernels import power_of_two, while_loop
from djpt.jit.llvm.calls import Code, call, reason_against
from djpt.jit.llvm.compiler import compiled
from djpt.jit.llvm.lanes import lane_count
from djpt.jit.types import Bool, Float, TensorXf, UInt32
from djpt.rendering.gradients.entry_function import ADD_ENTRIES, AT_ONCE, HEADER, LARGEST, entry_function

__all__ = ["EntrySums", "Read", "Repeated", "entry_sums", "prepare_functions", "summed"]

MOST = 2**24
"""The numbers of all copies of the sums together, 64 MiB."""

SHARED_BY = 4
"""As many threads may share a copy: of eight turns of a loop in one a thread has taken one."""

FEWEST, PACKET = 2**10, 16
"""The entries of a copy, and the lanes that add to a repeat in turn: smaller tables are repeated within each. One
number in float that all lanes of a pass add to stagnates, and was 0.2 % too small after 2^21 lanes."""

CHANNELS = {1: 1, 2: 2, 4: 3}
"""The channels of an entry that is tried, by its size."""

Read = tuple[UInt32, Any]
"""An address, and the derivative of the entry there."""


class EntrySums(Protocol):
    """The sums for the tensors of a `Buffer`."""

    calls: bool
    """Whether `add` has a result."""

    def add(self, entries: Sequence[Read], active: Bool) -> Bool:
        """Add entries of active lanes. Calls take place only if the result, true where there was one, is used."""

    def total(self) -> Float:
        """The sums, in the layout of the buffer."""


def entry_sums(buffer: Buffer, lanes: int) -> EntrySums:
    """Zeros for all entries of a buffer, to which a kernel of so many lanes adds."""
    if usable(buffer.entry_size):
        threads = dr.thread_count()
        copies = min(threads, MOST // stride_of(buffer))
        if copies * SHARED_BY >= threads:
            return CalledSums(buffer, lanes, copies)
    return ScatteredSums(buffer, lanes)


class Repeated:
    """The places of a small table that is repeated in memory.

    Args:
        entries: the entries of the table.
        lanes: the lanes of the kernel that adds to it.
    """

    def __init__(self, entries: int, lanes: int) -> None:
        self.count = repeats(entries)
        self._turn = dr.arange(UInt32, lanes) // PACKET & dr.opaque(UInt32, self.count - 1)
        self._entries = dr.opaque(UInt32, entries)

    def address(self, address: UInt32) -> UInt32:
        """The address in the repeat whose turn it is in each lane."""
        return dr.fma(self._turn, self._entries, address)


class ScatteredSums:
    """Sums by Dr.Jit's atomic additions."""

    calls = False

    def __init__(self, buffer: Buffer, lanes: int) -> None:
        self._buffer, self._repeated = buffer, Repeated(entries_of(buffer), lanes)
        self._memory = dr.zeros(Float, self._repeated.count * buffer.size)

    def add(self, entries: Sequence[Read], active: Bool) -> Bool:
        for address, entry in entries:
            self._buffer.add_to(self._memory, self._repeated.address(address), entry, active)
        return Bool(False)

    def total(self) -> Float:
        return summed(self._memory, self._buffer.size, self._repeated.count)


class CalledSums:
    """Sums by calls: several copies, see `djpt.rendering.gradients.entry_function`."""

    calls = True

    def __init__(self, buffer: Buffer, lanes: int, copies: int) -> None:
        # The last packet may have lanes beyond the last one.
        self._exist = dr.arange(UInt32, lanes) < dr.opaque(UInt32, lanes)
        self._buffer, self._repeated = buffer, Repeated(entries_of(buffer), lanes)
        self._copies, self._stride = copies, stride_of(buffer)
        self._memory = dr.opaque(Float, 0, copies * self._stride)
        self._words, self._count = dr.opaque(UInt32, self._stride), dr.opaque(Float, copies)
        self._code = function(buffer.entry_size)

    def add(self, entries: Sequence[Read], active: Bool) -> Bool:
        taken = Bool(False)
        active = active & self._exist
        for k in range(0, len(entries), AT_ONCE):
            indices, numbers = [], []
            for address, entry in entries[k : k + AT_ONCE]:
                channels = [entry] if self._buffer.channels == 1 else list(entry)
                indices.append(self._repeated.address(address))
                numbers += [*channels, *[Float(0)] * (LARGEST - len(channels))]
            # A second entry of zeros changes nothing.
            numbers += [Float(0)] * (AT_ONCE * LARGEST - len(numbers))
            # Most lanes without a derivative have the same address: one addition would wait for the other.
            adds = active & any_number(numbers)
            inputs = [Bool(False), adds, *numbers, self._count, indices[0], indices[-1], self._words]
            # The function leaves the end of the "ray", the count, as it is: nothing is ever blocked.
            (blocked,) = call(self._code, self._memory, [dr.detach(x) for x in inputs], [Bool(False)], any_hit=True)
            taken |= adds & ~blocked
        return taken

    def total(self) -> Float:
        return summed(self._memory, self._buffer.size, self._repeated.count, HEADER, self._copies, self._stride)


def summed(memory: Float, size: int, within: int, first: int = 0, copies: int = 1, stride: int = 0) -> Float:
    """The sums of `size` numbers over repeats in `memory`.

    Args:
        memory: the numbers.
        size: how many there are.
        within: how often they follow one another.
        first: the place of the first one.
        copies: how often that is so, ...
        stride: ... each so many words after the one before.
    """
    index, words = dr.arange(UInt32, size) + dr.opaque(UInt32, first), dr.opaque(UInt32, size)
    repeats, beyond, count = (dr.opaque(UInt32, n) for n in (within, stride, within * copies))

    def body(k: UInt32, total: Float) -> tuple[UInt32, Float]:
        copy = k // repeats
        place = index + copy * beyond + (k - copy * repeats) * words
        return k + 1, total + dr.gather(Float, memory, place)

    start = dr.zeros(UInt32, size), dr.zeros(Float, size)
    _, total = while_loop(start, lambda k, total: k < count, body, label="entry sums")
    dr.eval(total)
    return total


def any_number(numbers: Sequence[Float]) -> Bool:
    """True where a number isn't 0."""
    found = Bool(False)
    for number in numbers:
        found |= number != 0
    return found


def stride_of(buffer: Buffer) -> int:
    """The words of a copy, in whole cache lines."""
    return HEADER + -(-repeats(entries_of(buffer)) * buffer.size // HEADER) * HEADER


def entries_of(buffer: Buffer) -> int:
    """The entries of all its tensors."""
    return buffer.size // buffer.entry_size


def repeats(entries: int) -> int:
    """How often a table of so many entries stands in a copy, a power of two."""
    return power_of_two(FEWEST // entries)


# ---- the function ----------------------------------------------------------------------------

_functions: dict[tuple[int, int], Code] = {}
"""The functions that have been compiled, by the size of entries and the width of packets."""


def function(size: int) -> Code:
    """The function for entries of `size` numbers, compiled at the first call."""
    key = size, lane_count()
    if key not in _functions:
        _functions[key] = Code.at(compiled(entry_function(*key), (ADD_ENTRIES,))[ADD_ENTRIES])
    return _functions[key]


def prepare_functions(sizes: Iterable[int]) -> None:
    """Compile and prove the functions for entries of some sizes, which frozen functions can't."""
    for size in sizes:
        usable(size)


def usable(size: int) -> bool:
    """Whether entries of `size` numbers can be added by calls."""
    if size not in CHANNELS or asked_for() == "steps":
        return False
    return (size, lane_count()) in _functions if recording() else works(size)


@cache
def works(size: int) -> bool:
    """Whether calls add what they are to add."""
    return reason_against(lambda: proved(size), "derivatives of known sums got others") is None


def proved(size: int) -> bool:
    """Whether entries whose sums are known are added up to them."""
    lanes, rows, skipped = 2 * lane_count() + 3, 5, 1
    channels = CHANNELS[size]
    sums = CalledSums(Buffer([dr.zeros(TensorXf, (rows, 1, channels))], [0]), lanes, 2)
    lane = dr.arange(UInt32, lanes)
    values = [Float(lane) + 10 * c for c in range(channels)]
    entry: Any = values[0] if channels == 1 else values
    taken = sums.add([(lane % rows, entry), (lane % rows, entry), (lane * 0, entry)], lane != skipped)
    dr.eval(taken)
    numbers = np.arange(lanes)[:, None] + 10.0 * np.arange(channels)
    numbers[skipped] = 0
    expected = np.zeros((rows, size))
    for i, row in enumerate(numbers):
        expected[i % rows, :channels] += 2 * row
    expected[0, :channels] += numbers.sum(axis=0)
    return bool(np.allclose(np.array(sums.total()).reshape(expected.shape), expected))
