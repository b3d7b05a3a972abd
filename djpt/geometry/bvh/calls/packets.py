"""The entry points of searches: functions that kernels call with a packet of rays.

Dr.Jit calls them as it would call Embree: with a mask, a pointer to the scene, a context, and the rays as one
array per field, with a number for each lane of the packet.
"""

from __future__ import annotations

from djpt.geometry.bvh.calls.layout import ANY_HIT
from djpt.geometry.bvh.calls.placed import Features
from djpt.geometry.bvh.calls.ray import RayTerms
from djpt.geometry.bvh.calls.traversal import ANY, CLOSEST, FIELDS, Hit, add_search
from djpt.jit.llvm.ir import F32, I32, PTR, Function, Module, Value, vector

__all__ = ["ANY_OF_PACKET", "CLOSEST_OF_PACKET", "packet_functions"]

CLOSEST_OF_PACKET, ANY_OF_PACKET = f"{CLOSEST}_of_packet", f"{ANY}_of_packet"
"""The functions' names."""

B1, B2, RECORD, INSIDE = 15, 16, 17, 18
"""The arrays for the closest hit, with `maxt` for its distance. A value in INSIDE tells Dr.Jit that there is one."""

BLOCKED = float("-inf")
"""The `maxt` of a ray that is blocked, for Dr.Jit."""


def packet_functions(width: int, features: Features) -> str:
    """The functions for packets of `width` rays, in LLVM's language."""
    module = Module()
    for kind in (ANY, CLOSEST):
        add_search(module, kind, features, width)
        parameters = [("valid", PTR), ("scene", PTR), ("context", PTR), ("rays", PTR)]
        with module.function(f"{kind}_of_packet", parameters) as f:
            Packet(f, width).search(kind)
    return module.text()


class Packet:
    """A packet of rays; the function for it is being built."""

    def __init__(self, f: Function, width: int) -> None:
        self.f, self.width = f, width
        self.valid, self.scene, _, self.rays = f.parameters
        self.found = f.array(I32, 5)

    def search(self, kind: str) -> None:
        """Search for one ray after the other."""
        f, terms = self.f, self.terms()
        with f.each(0, self.width) as lane, f.when(f.load(I32, self.valid.at(lane * 4)) != 0):
            arguments = [self.scene, self.rays, terms, lane]
            if kind == ANY:
                self.search_any(arguments, lane)
            else:
                flags = f.load(I32, self.field("flags", lane))
                with f.either((flags & ANY_HIT) != 0) as branch:
                    self.search_any(arguments, lane, keeps_distance=True)
                    branch.otherwise()
                    self.search_closest(arguments, lane)

    def terms(self) -> Value:
        """The address of the terms of all rays, computed at once for the whole packet."""
        f, row = self.f, vector(F32, self.width)
        o, d = (
            [f.load(row, self.rays.at(4 * self.width * (FIELDS[part] + axis)), row.size) for axis in range(3)]
            for part in "od"
        )
        values = RayTerms.of(o, d).values()
        memory = f.reserve(row, len(values))
        for k, value in enumerate(values):
            f.store(value, memory.at(row.size * k), row.size)
        return memory

    def search_any(self, arguments: list[Value], lane: Value, keeps_distance: bool = False) -> None:
        """Look for any hit; it is reported by the distance, or like a closest hit without a place."""
        f = self.f
        hit = f.call(ANY, arguments, I32)
        assert hit is not None
        with f.when(hit != 0):
            if keeps_distance:
                f.store(f.constant(I32, 1), self.field(RECORD, lane))
                f.store(f.constant(I32, 0), self.field(INSIDE, lane))
            else:
                f.store(f.constant(F32, BLOCKED), self.field("maxt", lane))

    def search_closest(self, arguments: list[Value], lane: Value) -> None:
        """Look for the closest hit and write it to its lane."""
        f, found = self.f, self.found.address
        hit = f.call(CLOSEST, [*arguments, found], I32)
        assert hit is not None
        with f.when(hit != 0):
            out = Hit.at(found)
            targets: tuple[str | int, ...] = ("maxt", B1, B2, RECORD, INSIDE)
            for source, target in zip((out.t, out.b1, out.b2, out.record, out.inside), targets, strict=True):
                f.store(f.load(I32, source), self.field(target, lane))

    def field(self, field: str | int, lane: Value) -> Value:
        """The address of a lane's number in an array."""
        index = FIELDS[field] if isinstance(field, str) else field
        return self.rays.at((lane + index * self.width) * 4)
