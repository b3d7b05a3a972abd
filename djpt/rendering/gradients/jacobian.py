"""The Jacobian of an image: the derivative of each pixel by each entry of the parameters, from one replay of its paths.

Searches of second order ask for J v and J^T w again and again at one place. A replay for each costs more than an image,
with the same samples every time. Here one replay adds the derivatives of samples to the rows of their pixels,

    J[channel of a pixel; entry] = mean over the samples of the pixel of d channel / d entry,

by one reverse derivative per channel at each vertex. From then on products are sums over tables in memory. A colour of
a material changes no other channel than its own. A derivative that vanishes for all rays is a literal 0 while the loop
is traced, and gets no table. Where the film filters, pixels have samples of their own
(`djpt.rendering.gradients.filter_sampling`), so that each lane still adds to one row.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import drjit as dr

from djpt.core.lookup import Numbers
from djpt.dispatch.ensemble import TableLeaf
from djpt.integrators.base import PathIntegrator
from djpt.jit.kernels import while_loop
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Array4f, Bool, Color3f, Float, TensorXf, UInt32
from djpt.rendering.gradients.derivatives import ReplayDerivative, on_grid
from djpt.rendering.gradients.filter_sampling import FilteredJob, own_samples
from djpt.rendering.gradients.leaves import Leaves, Tangents, components
from djpt.rendering.gradients.modes import Mode, Sample, Walk
from djpt.rendering.schedules.flat import Flat
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.passes import image_of_samples, register_spp

__all__ = ["Jacobian", "KnownDerivative", "jacobian_of"]

LARGEST = 2**24
"""The most numbers of a Jacobian, 64 MiB: to read more is expected to take longer than to replay paths."""

UNIFORM = 0
"""The number of the space whose entries are the parameters that aren't tables."""

PACKED = 4
"""The numbers of a pixel that stand side by side, and are added at once: docs/performance.md has the gain."""


@dataclass
class Pack:
    """Up to `PACKED` tables, [entry][pixel][table], of derivatives of an image."""

    space: int
    """The number of the space of entries."""
    keys: list[tuple[int, int]]
    """What the tables are: the component of the space's entries, and the channel of the pixels."""
    memory: Float

    def at(self, place: UInt32) -> Array4f:
        """The numbers of a pixel in the row of an entry."""
        found: Array4f = dr.gather(Array4f, self.memory, place)
        return found


@dataclass
class Jacobian:
    """The derivatives of an image; those that no pack has are 0."""

    packs: list[Pack]

    def mixed(self, other: Jacobian, share: float) -> Jacobian:
        """The weighted mean with a Jacobian of other samples, whose weight is `share`, in [0, 1]."""
        one, two = (dr.opaque(Float, number) for number in (1 - share, share))
        pairs = zip(self.packs, other.packs, strict=True)
        packs = [replace(a, memory=a.memory * one + b.memory * two) for a, b in pairs]
        dr.eval([pack.memory for pack in packs])
        return Jacobian(packs)


def row_length(pixels: int) -> int:
    """The pixels of a row, some beyond the last one: an odd number of the processor's lines of 64 bytes.

    The same pixel of many rows is read and written in turn. If it were at multiples of 4 KiB, few would fit in a cache.
    """
    return PACKED * (-(-pixels // PACKED) | 1)


class Spaces:
    """The columns of a Jacobian: the entries of the parameters, in the order of the buffers that hold them."""

    def __init__(self, derivative: ReplayDerivative) -> None:
        numbering, self.parameters = derivative.numbering, derivative.parameters
        self.tables = [leaf for leaf in numbering.leaves if isinstance(leaf, TableLeaf)]
        self.buffers = [derivative.values.buffer(leaf) for leaf in self.tables]
        # Members without a parameter point beyond the end.
        self._numbers = {
            id(leaf): Numbers([len(self.parameters) if n is None else n for n in numbering.of(leaf)])
            for leaf in numbering.leaves
            if not isinstance(leaf, TableLeaf)
        }

    def entries(self, space: int) -> int:
        """The number of entries of a space."""
        if space == UNIFORM:
            return len(self.parameters)
        buffer = self.buffers[space - 1]
        return buffer.size // buffer.entry_size

    def read(self, leaves: Leaves) -> list[tuple[int, UInt32, Any]]:
        """The space, the number and the AD leaf of each entry that was read at a vertex."""
        found = [(UNIFORM, self._numbers[id(leaf)].at(slot), value) for leaf, slot, value in leaves.taken]
        number = {id(leaf): i + 1 for i, leaf in enumerate(self.tables)}
        return found + [(number[id(leaf)], address, entry) for leaf, address, entry in leaves.read]

    def changes(self, space: int, changes: Sequence[Any], tangents: Tangents) -> Callable[[UInt32], list[Float]]:
        """The components of the change of an entry, as a function of its number."""
        if space != UNIFORM:
            return lambda entry: components(tangents.entry(self.tables[space - 1], entry))
        numbers = zip(self.parameters, changes, strict=True)
        flat = dr.concat([c for p, change in numbers for c in padded([] if p.is_table else components(change))])
        dr.make_opaque(flat)
        return lambda entry: [dr.gather(Float, flat, 3 * entry + c) for c in range(3)]

    def gradients(self, sums: dict[tuple[int, int], Float]) -> list[Any]:
        """The gradients of the parameters, from the sums for the components of the entries of the spaces."""
        result = []
        for i, parameter in enumerate(self.parameters):
            kind = type(parameter.value)
            if not parameter.is_table:
                parts = [sums.get((UNIFORM, c)) for c in range(parameter.size)]
                result.append(kind(*(Float(0) if p is None else dr.gather(Float, p, UInt32(i)) for p in parts)))
                continue
            shape = parameter.value.shape
            total = dr.zeros(Float, dr.prod(shape))
            # A texture may stand in several groups: each has a buffer.
            for space, (leaf, buffer) in enumerate(zip(self.tables, self.buffers, strict=True), UNIFORM + 1):
                if leaf.attribute == parameter.attribute and parameter.owner in leaf.owners:
                    memory = dr.zeros(Float, buffer.size)
                    for c in range(buffer.channels):
                        if (space, c) in sums:
                            number = dr.arange(UInt32, self.entries(space))
                            dr.scatter(memory, sums[space, c], number * buffer.entry_size + c)
                    total += buffer.unpacked(memory, id(parameter.owner), shape)
            result.append(kind(total, shape))
        return result


Slopes = dict[tuple[int, int], Float]
"""The derivatives of a sample by an entry, by the component of the entry and the channel."""


class Rows(Mode):
    """Adds the derivatives of the channels of samples to the rows of their pixels.

    Args:
        job: Of the image.
        spaces: The columns.
        pixel: That of each lane: no two lanes have the same.
    """

    label: ClassVar[str] = "jacobian"
    takes_long: ClassVar[bool] = True

    def __init__(self, job: Job, spaces: Spaces, pixel: UInt32) -> None:
        self.packs: dict[int, list[Pack]] = {}
        """The tables, by the numbers of spaces."""
        self._job, self._spaces, self._pixel = job, spaces, pixel
        self._pixels, self._inverse = dr.opaque(UInt32, dr.width(pixel)), dr.opaque(Float, 1 / job.spp)
        self._length = row_length(dr.width(pixel))

    def start(self) -> list[Float]:
        return []

    def delta_of(self, slot: UInt32, active: Bool) -> Color3f:
        if not isinstance(self._job, FilteredJob):
            return Color3f(1)
        # The weight of a sample.
        return Color3f(self._job.weight(self._pixel, slot // self._pixels))

    def differentiate(self, walk: Walk, leaves: Leaves, outgoing: Color3f, active: Bool) -> tuple[Color3f, list[Float]]:
        read, counts = self._spaces.read(leaves), walk.delta.x * self._inverse
        slopes: list[Slopes] = [{} for _ in read]
        for channel in range(self._job.channel_count()):
            unit = [Float(i == channel) for i in range(self._job.channel_count())]
            value: Any = dr.dot(outgoing, self._job.color_adjoint(unit))
            if not dr.grad_enabled(value):
                continue
            dr.backward(value, flags=dr.ADFlag.ClearVertices)
            for (_, _, leaf), found in zip(read, slopes, strict=True):
                for component, slope in enumerate(components(dr.grad(leaf))):
                    if slope.state != dr.VarState.Literal or slope[0]:
                        found[component, channel] = slope * counts
            dr.clear_grad([leaf for _, _, leaf in read])
        for space in {space for space, _, _ in read}:
            of_space = (found for (number, _, _), found in zip(read, slopes, strict=True) if number == space)
            self._make(space, sorted(set[tuple[int, int]]().union(*of_space)))
        for (space, entry, _), found in zip(read, slopes, strict=True):
            self._add(space, entry, found, active)
        return walk.delta, walk.sums

    def _make(self, space: int, keys: list[tuple[int, int]]) -> None:
        if space not in self.packs:
            size = self._spaces.entries(space) * self._length * PACKED
            chunks = [keys[i : i + PACKED] for i in range(0, len(keys), PACKED)]
            self.packs[space] = [Pack(space, chunk, dr.zeros(Float, size)) for chunk in chunks]

    def _add(self, space: int, entry: UInt32, slopes: Slopes, active: Bool) -> None:
        inside = active & (entry < dr.opaque(UInt32, self._spaces.entries(space)))
        place = dr.fma(entry, dr.opaque(UInt32, self._length), self._pixel)
        for pack in self.packs[space]:
            values = [slopes.get(key, Float(0)) for key in pack.keys]
            values += [Float(0)] * (PACKED - len(values))
            # Each lane has rows of its own.
            dr.scatter_add(pack.memory, Array4f(*values), place, inside, mode=dr.ReduceMode.NoConflicts)

    def hand_over(
        self, job: Job, walk: Sample, finished: Bool, next_slot: UInt32, more: Bool, counts: Bool | bool = True
    ) -> tuple[Color3f, list[Float]]:
        return dr.select(finished, self.delta_of(next_slot, more), walk.delta), walk.sums


def jacobian_of(derivative: Any) -> Jacobian | None:
    """The Jacobian of an image whose derivative is found by replay; None for others, or if it would be too large."""
    if not isinstance(derivative, ReplayDerivative):
        return None
    job = own_samples(derivative.job)
    if job is None or not isinstance(job.integrator, PathIntegrator) or "flat" not in job.integrator.schedules:
        return None
    spaces, rows = Spaces(derivative), list[Rows]()
    colours = sum(spaces.entries(space) for space in range(len(spaces.tables) + 1)) * job.channel_count()
    if colours * job.width * job.height > LARGEST or job.spp > register_spp(job):
        return None

    def mode_of(lanes: int, pixel: UInt32) -> Rows:
        rows.append(Rows(job, spaces, pixel))
        return rows[-1]

    with dr.suspend_grad():
        given = derivative.values, derivative.numbering, Band(0, job.height), 0, job.spp, mode_of
        _, _, number = Flat().replay(job, *given, shared=False)
        packs = [pack for of_space in rows[-1].packs.values() for pack in of_space]
        with small_blocks():
            dr.eval(number, [pack.memory for pack in packs])
        return Jacobian(packs)


class KnownDerivative:
    """The derivative of an image whose Jacobian is known."""

    def __init__(self, derivative: ReplayDerivative, jacobian: Jacobian) -> None:
        self.jacobian = jacobian
        """May be replaced by that of other samples."""
        self._job = replace(derivative.job, spp=1, film=derivative.job.film.unfiltered())
        self._numbering, self._spaces = derivative.numbering, Spaces(derivative)
        self._pixels = self._job.width * self._job.height
        self._length = row_length(self._pixels)

    def backward(self, image: TensorXf) -> list[Any]:
        """The gradients of the parameters, from the derivatives with respect to the pixels (H, W, C)."""
        with dr.suspend_grad():
            adjoints = on_grid(self._job, image)
            products: dict[tuple[int, int], Float] = {}
            for pack in self.jacobian.packs:
                place = dr.arange(UInt32, dr.width(pack.memory) // PACKED)
                # The length is written into the kernel: to divide by an input takes longer than all else.
                pixel, numbers = place % self._length, pack.at(place)
                weights = [dr.gather(Float, adjoint, pixel, pixel < self._pixels) for adjoint in adjoints]
                for i, (component, channel) in enumerate(pack.keys):
                    column = pack.space, component
                    products[column] = dr.fma(numbers[i], weights[channel], products.get(column, Float(0)))
            sums = {column: dr.block_sum(product, self._length) for column, product in products.items()}
            dr.eval(sums)
            return self._spaces.gradients(sums)

    def forward(self, tangents: list[Any]) -> TensorXf:
        """The derivative of the image in the direction of `tangents`, one per parameter."""
        with dr.suspend_grad():
            changes, pixel = Tangents(self._numbering, tangents), dr.arange(UInt32, self._pixels)
            channels = [dr.zeros(Float, self._pixels) for _ in range(self._job.channel_count())]
            for space in sorted({pack.space for pack in self.jacobian.packs}):
                channels = self._with_space(space, tangents, changes, pixel, channels)
            dr.eval(channels)
            return image_of_samples(self._job, channels)

    def _with_space(
        self, space: int, tangents: list[Any], changes: Tangents, pixel: UInt32, channels: list[Float]
    ) -> list[Float]:
        """The changes of the channels, with those due to the entries of a space added."""
        packs = [pack for pack in self.jacobian.packs if pack.space == space]
        entries, length = dr.opaque(UInt32, self._spaces.entries(space)), dr.opaque(UInt32, self._length)
        change_of = self._spaces.changes(space, tangents, changes)

        def body(entry: UInt32, sums: list[Float]) -> tuple[UInt32, list[Float]]:
            change, place, sums = change_of(entry), dr.fma(entry, length, pixel), list(sums)
            for pack in packs:
                numbers = pack.at(place)
                for i, (component, channel) in enumerate(pack.keys):
                    sums[channel] = dr.fma(numbers[i], change[component], sums[channel])
            return entry + 1, sums

        start = dr.zeros(UInt32, self._pixels), channels
        _, found = while_loop(start, lambda entry, sums: entry < entries, body, label="jacobian forward")
        return found


def padded(numbers: list[Float]) -> list[Float]:
    """Three numbers, the last ones 0."""
    return numbers + [Float(0)] * (3 - len(numbers))
