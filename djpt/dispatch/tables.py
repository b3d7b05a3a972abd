"""Tensors that kernels read entry by entry: the texels of a bitmap, the voxels of a grid.

Plugins of one group share a buffer in which their tensors follow each other. An entry is one number, or
the C channels of a texel if the tensor is (H, W, C) or (D, H, W, C); it is padded to a power of two numbers, so that a
lookup is a single gather of a packet, or two for more than four channels.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any, Protocol

import drjit as dr

from djpt.core.lookup import Rows
from djpt.jit.types import Array4f, ArrayXf, Bool, Color3f, Float, Point2f, UInt32

__all__ = ["Buffer", "Table", "channels_of", "entry_at", "entry_size"]

ENTRIES: dict[int, tuple[type, int]] = {
    1: (Float, 1),
    2: (Point2f, 2),
    3: (Color3f, 4),
    4: (Array4f, 4),
    6: (ArrayXf, 8),
}
"""The type of an entry and its size in memory, by the number of channels."""

LOCAL = dr.ReduceMode.Local
"""The mode in which gradients are summed.

With the default, Dr.Jit 1.5.0 makes a copy of small memory for every thread; packets are then written beyond the end,
and sums that are evaluated half-way are lost.
"""


class Table(Protocol):
    """The stand-in for a tensor in kernels, of which single entries are looked up."""

    @property
    def attached(self) -> bool:
        """True if the entries are AD leaves, or depend on some."""

    def at(self, index: UInt32, active: Bool | bool = True) -> Any:
        """Entry number `index`, counted row by row: `Float`, `Color3f` for three channels, `ArrayXf` for six."""


def channels_of(tensor: Any) -> int:
    """The count of numbers in an entry: the channels of (H, W, C) or (D, H, W, C), else 1."""
    return int(tensor.shape[-1]) if len(tensor.shape) in (3, 4) else 1


def entry_size(tensor: Any) -> int:
    """The numbers of an entry in a buffer, padding included."""
    return ENTRIES[channels_of(tensor)][1]


class Buffer:
    """The tensors of a group's members in memory, one after the other."""

    def __init__(self, tensors: Sequence[Any], identity: Sequence[Hashable]) -> None:
        """Copy the tensors; members of equal `identity` share theirs. If tensors are attached, so is the buffer."""
        self.channels = channels_of(tensors[0])
        self._entry, self._size = ENTRIES[self.channels]
        self._first: dict[Hashable, int] = {}
        different: list[Any] = []
        size = 0
        for tensor, key in zip(tensors, identity, strict=True):
            if key not in self._first:
                self._first[key] = size
                size += entries(tensor)
                different.append(tensor)
        self.size = size * self._size
        parts = [self._padded(tensor) for tensor in different]
        if dr.grad_enabled(*parts):
            self._memory: Any = dr.concat(parts) if len(parts) > 1 else parts[0]
            dr.make_opaque(self._memory)
        elif len(parts) == 1 and self.channels != self._size:
            # The padded numbers themselves. Without padding they would be the tensor's own memory, not a copy.
            self._memory = parts[0]
            dr.make_opaque(self._memory)
        else:
            self._memory = dr.zeros(Float, self.size)
            first = 0
            for part in parts:
                dr.scatter(self._memory, part, dr.arange(UInt32, dr.width(part)) + dr.opaque(UInt32, first))
                first += dr.width(part)
            dr.eval(self._memory)
        starts = [dr.opaque(UInt32, self._first[key]) for key in identity]
        self._starts = Rows(starts, list(identity))

    def _padded(self, tensor: Any) -> Float:
        if self.channels == self._size:
            return tensor.array
        index = dr.arange(UInt32, entries(tensor) * self._size)
        entry, channel = index // self._size, index % self._size
        return dr.gather(Float, tensor.array, entry * self.channels + channel, channel < self.channels, mode=LOCAL)

    @property
    def entry_size(self) -> int:
        """The numbers of an entry in memory, padding included."""
        return self._size

    @property
    def attached(self) -> bool:
        """True if the memory depends on AD leaves."""
        return bool(dr.grad_enabled(self._memory))

    def address(self, slot: UInt32, index: UInt32) -> UInt32:
        """The address of entry `index` of the member number `slot`."""
        return self._starts.at(slot) + index

    def read(self, address: UInt32, active: Bool | bool = True) -> Any:
        """The entry at an address."""
        if self.channels == 6:
            halves = (dr.gather(Array4f, self._memory, address * 2 + k, active, mode=LOCAL) for k in range(2))
            return ArrayXf([c for half in halves for c in half][:6])
        if self.channels != 3:
            return dr.gather(self._entry, self._memory, address, active, mode=LOCAL)
        texel = dr.gather(Array4f, self._memory, address, active, mode=LOCAL)
        return Color3f(texel.x, texel.y, texel.z)

    # ---- sums of gradients -----------------------------------------------------------------

    def add_to(self, memory: Float, address: UInt32, entry: Any, active: Bool) -> None:
        """Add an entry to the numbers at an address of `memory`, which has the layout of this buffer."""
        for c in range(self.channels):
            component = entry if self.channels == 1 else entry[c]
            dr.scatter_add(memory, component, address * self._size + c, active)

    def unpacked(self, memory: Float, key: Hashable, shape: Sequence[int]) -> Float:
        """The part of `memory` that belongs to one tensor, without its padding."""
        index = dr.arange(UInt32, dr.prod(shape))
        start = dr.opaque(UInt32, self._first[key])
        return dr.gather(Float, memory, (index // self.channels + start) * self._size + index % self.channels)


def entry_at(table: Any, index: UInt32, active: Bool | bool = True) -> Any:
    """Entry number `index` of a table, or of the tensor that stands there outside of kernels."""
    if not dr.is_tensor_v(table):
        return table.at(index, active)
    channels = channels_of(table)
    if channels == 6:
        return ArrayXf([dr.gather(Float, table.array, index * 6 + c, active) for c in range(6)])
    return dr.gather(ENTRIES[channels][0], table.array, index, active)


def entries(tensor: Any) -> int:
    """The number of entries of a tensor."""
    return dr.width(tensor.array) // channels_of(tensor)
