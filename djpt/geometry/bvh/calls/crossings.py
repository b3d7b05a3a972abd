"""The lengths of rays through media whose boundaries are invisible meshes, by one search of a tree, in LLVM IR.

A shadow ray goes straight through invisible surfaces, and needs to know two things: whether something opaque stands in
its way, and how far it runs through each medium. A search for any hit of an opaque triangle meets the invisible ones
anyway. Here it notes them: each crossing of a boundary goes into a list of its ray, sorted by distance, with the medium
behind it. The first opaque hit ends the search, as always; at the end the pieces between crossings are added up.

The medium behind a crossing doesn't depend on the one before it: where bodies nest or overlap, the boundary that was
crossed last decides, as on paths that go from one surface to the next. It doesn't matter in which order boundaries are
found, nor that a ray which hits an edge crosses both of its triangles.

A list has a fixed length, and holds the nearest crossings. Where there were more, the pieces up to its end are
added up, and the search is made again for crossings behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from djpt.geometry.bvh.calls.layout import BOUNDS, CHILDREN, MEDIA, MEDIUM_BITS, ROOT, ROW_BYTES
from djpt.geometry.bvh.calls.ray import Features
from djpt.geometry.bvh.calls.rings import RingSearch
from djpt.geometry.bvh.calls.traversal import B1, B2, FIELDS, INSIDE, PACKET, RECORD
from djpt.geometry.query import NORMAL
from djpt.jit.llvm.arithmetic import fma, lowest_bit, select
from djpt.jit.llvm.ir import F32, I32, I64, Function, Module, Value

__all__ = ["LENGTHS_OF_PACKET", "crossing_function"]

LENGTHS_OF_PACKET = "lengths_of_packet"
"""The function's name."""

ENTRIES = 16
"""The crossings of a list."""

LENGTHS = (FIELDS["maxt"], B1, B2, RECORD)
"""The arrays for the lengths through each medium."""

NUMBER = (1 << MEDIUM_BITS) - 1


def crossing_function(width: int, features: Features) -> str:
    """The function for packets of `width` rays, in LLVM's language; no scene with instances has one.

    Its parameters are those of `djpt.geometry.bvh.calls.traversal.packet_function`. The flags of a ray hold the number
    of the medium in which it begins, above `MEDIUM_BITS` other bits. The results are the lengths
    through media 1 to `MEDIA`, and 0 in the array INSIDE. For rays that are blocked it is 1, and lengths are 0.
    """
    module = Module()
    with module.function(LENGTHS_OF_PACKET, PACKET) as f:
        # Shapes that emit are hit like all others.
        CrossingSearch(f, replace(features, lights=False), width).build()
    return module.text()


class CrossingSearch(RingSearch):
    """The search for the crossings of a packet of rays; the function for it is being built."""

    def __init__(self, f: Function, features: Features, width: int) -> None:
        super().__init__(f, True, features, width)
        self.crossings = f.array(I64, width * ENTRIES)
        """The lists: a distance, as the bits of a float, in the upper half, and the medium behind."""
        self.counts, self.dropped = f.array(I32, width), f.array(I32, width)
        """The entries of lists; whether there were more."""
        self.added = f.array(I64, width)
        """The last entry of the list before, whose pieces have been added up."""
        self.lengths = f.array(F32, width * (1 + MEDIA))
        self.media, self.starts = f.array(I32, width), f.array(F32, width)
        """The medium behind that entry, and its distance."""
        self.follows = f.array(I32, width)
        """Whether a ray is still to be followed."""

    def build(self) -> None:
        """Search, and add up what was found, until no list was too short."""
        f = self.f
        self.begin()
        with f.each(0, self.width) as lane:
            for medium in range(1 + MEDIA):
                self.lengths[lane * (1 + MEDIA) + medium] = 0.0
            self.added[lane] = 0
            self.counts[lane] = 0
            self.dropped[lane] = 0
            self.starts[lane] = 0.0
            self.media[lane] = f.load(I32, self.number("flags", lane)) >> MEDIUM_BITS
            self.follows[lane] = f.load(I32, self.valid.at(lane * 4))
        with f.loop() as rounds:
            self.search()
            with f.each(0, self.width) as lane, f.when(self.follows[lane] != 0):
                self.add_up(lane)
            rounds.stop_if(self.nodes.count == 0)
        f.give()

    # ---- crossings ---------------------------------------------------------------------------------

    def take_closest(self, entry: Value, hits: Value, t: Value, weights: Sequence[Value]) -> None:
        """Note all passable triangles of a mask, or that one is opaque."""
        f, lane = self.f, entry >> 32
        leaf, d = self.at_reference(entry), self.direction_of(lane)
        distances, remaining = f.array(F32, CHILDREN), f.variable(I32, hits)
        distances.store(t)
        with f.loop() as candidates:
            bits = remaining.value
            candidates.stop_if(bits == 0)
            slot = lowest_bit(bits)
            remaining.value = bits & (bits - 1)
            row = self.scene.at(self.record_of(lane, leaf, slot).to(I64) * ROW_BYTES)
            way = f.load(I32, row)
            with f.when(way == 0):
                self.block(lane)
                candidates.stop()
            candidates.again_if((way & BOUNDS) == 0)
            x, y, z = (f.load(F32, row.at(4 * (NORMAL + axis))) for axis in range(3))
            leaves = fma(x, d[0], fma(y, d[1], z * d[2])) > 0.0
            medium = select(leaves, way, way >> MEDIUM_BITS) & NUMBER
            self.insert(lane, (distances[slot].bits_as(I32).to(I64) << 32) | medium.to(I64))

    def insert(self, lane: Value, crossing: Value) -> None:
        """Put a crossing into a ray's list; if that is full, the farthest has no place there."""
        f, first = self.f, lane * ENTRIES
        count = self.counts[lane]
        full = count == ENTRIES
        last = self.crossings[first + (ENTRIES - 1)]
        # Distances are positive, so that their bits are sorted as they are.
        behind = crossing > self.added[lane]
        self.dropped[lane] = self.dropped[lane] | select(full & behind, f.constant(I32, 1), 0)
        with f.when(behind & (~full | (crossing < last))):
            self.counts[lane] = select(full, count, count + 1)
            place = f.variable(I64, select(full, count - 1, count).to(I64))
            with f.loop() as shift:
                shift.stop_if(place.value == 0)
                before = self.crossings[first + place.value - 1]
                shift.stop_if(before < crossing)
                self.crossings[first + place.value] = before
                place.value = place.value - 1
            self.crossings[first + place.value] = crossing

    # ---- lengths -----------------------------------------------------------------------------------

    def add_up(self, lane: Value) -> None:
        """Add up the pieces between the crossings of a list; then a ray has come to its end, or searches again."""
        f = self.f
        end = self.maxt(lane)
        with f.either(end < 0.0) as branch:
            for array in LENGTHS:
                f.store(f.constant(F32, 0.0), self.number(array, lane))
            self.finish(lane, 1)
            branch.otherwise()
            with f.each(0, self.counts[lane].to(I64)) as k:
                crossing = self.crossings[lane * ENTRIES + k]
                self.add_piece(lane, (crossing >> 32).to(I32).bits_as(F32))
                self.media[lane] = crossing.to(I32)
            with f.either(self.dropped[lane] != 0) as more:
                self.search_again(lane)
                more.otherwise()
                self.add_piece(lane, end)
                for medium, array in enumerate(LENGTHS, 1):
                    length = self.lengths[lane * (1 + MEDIA) + medium]
                    f.store(length, self.number(array, lane))
                self.finish(lane, 0)

    def add_piece(self, lane: Value, t: Value) -> None:
        """Add the piece of a ray up to a distance, through the medium behind the crossing before."""
        place = lane * (1 + MEDIA) + self.media[lane].to(I64)
        self.lengths[place] = self.lengths[place] + (t - self.starts[lane])
        self.starts[lane] = t

    def search_again(self, lane: Value) -> None:
        """Let a ray begin again at the root, to look for crossings behind the last of its list."""
        f = self.f
        self.added[lane] = self.crossings[lane * ENTRIES + (ENTRIES - 1)]
        self.counts[lane] = 0
        self.dropped[lane] = 0
        self.tops[lane] = 1
        self.nodes.offer((lane << 32) | ROOT, f.constant(I64, 1) != 0)

    def finish(self, lane: Value, blocked: int) -> None:
        """Note the end of a ray."""
        f = self.f
        self.follows[lane] = 0
        f.store(f.constant(I32, blocked), self.number(INSIDE, lane))
