"""The search for two rays of each lane at once, as functions in LLVM IR.

From a vertex of a path two rays set out: one to a light, one to the next vertex. Neither search needs the result of the
other. Few lanes have a ray to a light, too few to wait for each other's memory; in the same rings as the others
(`djpt.geometry.bvh.calls.rings`) they cost little more than their own work.

A call has room for one ray and four more words. So there are two: `KEEP_ORIGINS` leaves the origins of rays to lights
in arrays of the packet that Dr.Jit reserves for the normals of hits and doesn't touch. `PAIRS` follows and brings the
other words, `DIRECTION` and `END`. That the arrays stay as they are is proved at first use.
"""

from __future__ import annotations

from djpt.geometry.bvh.calls.layout import ANY_HIT
from djpt.geometry.bvh.calls.ray import Features
from djpt.geometry.bvh.calls.rings import RingSearch
from djpt.geometry.bvh.calls.traversal import B1, B2, BLOCKED, FIELDS, INSIDE, PACKET, RECORD
from djpt.jit.llvm.arithmetic import select
from djpt.jit.llvm.ir import F32, I32, Module, Value, vector

__all__ = ["DIRECTION", "END", "KEEP_ORIGINS", "PAIRS", "pair_functions"]

KEEP_ORIGINS, PAIRS = "keep_origins_of_packet", "pairs_of_packet"
"""The names of the functions."""

KEPT = 12
"""The first of the three arrays in which origins are kept."""
DIRECTION, END = (3, 7, 10), 11
"""The arrays of `PAIRS` with the direction of the ray to a light, and with its end: 0 if there is no ray."""
HIDDEN = 19
"""The array of results for rays to lights: 1 if anything is hit, else 0."""


def pair_functions(width: int, features: Features) -> str:
    """`KEEP_ORIGINS` and `PAIRS` for packets of `width` lanes, in LLVM's language.

    The processor must have AVX2, and `width` be a power of two. `PAIRS` gives the results of a search for the closest
    hit, and in the array `HIDDEN` whether anything lies in the way to the light.
    """
    module = Module()
    with module.function(KEEP_ORIGINS, PACKET) as f:
        valid, _, _, rays = f.parameters
        row, size = vector(F32, width), 4 * width
        for axis in range(3):
            f.store(f.load(row, rays.at(size * axis), size), rays.at(size * (KEPT + axis)), size)
        # That a ray is "blocked" tells Dr.Jit that there was a call, on which the next one depends.
        active = f.load(vector(I32, width), valid, size) != 0
        end = rays.at(size * FIELDS["maxt"])
        f.store(select(active, BLOCKED, f.load(row, end, size)), end, size)
    with module.function(PAIRS, PACKET) as f:
        valid, _, _, rays = f.parameters
        pairs = Pairs(valid, rays, width)
        search = RingSearch(f, False, features, 2 * width, (pairs.valid, pairs.rays))
        search.begin()
        search.search()
        pairs.give()
    return module.text()


class Pairs:
    """A packet with twice as many rays: in its upper half those to lights."""

    def __init__(self, valid: Value, rays: Value, width: int) -> None:
        """Copy the rays from the packet of a call."""
        f = self.f = valid.function
        self.width, self.size, self._packet = width, 4 * width, rays
        self.row, self.words = vector(F32, width), vector(I32, width)
        self.valid = f.reserve(vector(I32, 2 * width), 1)
        self.rays = f.reserve(vector(F32, 2 * width), INSIDE + 1)
        for axis in range(3):
            self.write(FIELDS["o"] + axis, self.given(FIELDS["o"] + axis), self.given(KEPT + axis))
            self.write(FIELDS["d"] + axis, self.given(FIELDS["d"] + axis), self.given(DIRECTION[axis]))
        end = self.given(END)
        self.write(FIELDS["maxt"], self.given(FIELDS["maxt"]), end)
        any_hit, nothing = (f.constant(self.words, number).bits_as(self.row) for number in (ANY_HIT, 0xFFFFFFFF))
        self.write(FIELDS["flags"], self.given(FIELDS["flags"]), any_hit)
        self.write(INSIDE, nothing, nothing)
        f.store(f.load(self.words, valid, self.size), self.valid, self.size)
        f.store(select(end > 0.0, f.constant(self.words, 1), 0), self.valid.at(self.size), self.size)

    def given(self, array: int) -> Value:
        """The numbers in an array of the call's packet."""
        return self.f.load(self.row, self._packet.at(self.size * array), self.size)

    def write(self, array: int, first: Value, second: Value) -> None:
        """Write both halves of an array."""
        for k, half in enumerate((first, second)):
            self.f.store(half, self.half(array, k), self.size)

    def half(self, array: int, k: int) -> Value:
        """The address of the lower half of an array, or of the upper one."""
        return self.rays.at(self.size * (2 * array + k))

    def give(self) -> None:
        """Write the results to the call's packet, and return."""
        f = self.f
        for array in (FIELDS["maxt"], B1, B2, RECORD, INSIDE):
            f.store(f.load(self.row, self.half(array, 0), self.size), self._packet.at(self.size * array), self.size)
        hidden = f.load(self.words, self.half(INSIDE, 1), self.size) != 0xFFFFFFFF
        f.store(select(hidden, f.constant(self.words, 1), 0), self._packet.at(self.size * HIDDEN), self.size)
        f.give()
