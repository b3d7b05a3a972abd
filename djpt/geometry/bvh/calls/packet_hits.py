"""The hits that the rays of a packet have found so far, in vectors with a lane for each ray, in LLVM IR."""

from __future__ import annotations

from collections.abc import Sequence

from djpt.geometry.bvh.calls.layout import ANY_HIT
from djpt.geometry.bvh.calls.ray import Features
from djpt.geometry.bvh.calls.traversal import B1, B2, BLOCKED, FIELDS, INSIDE, RECORD, lines_of
from djpt.jit.llvm.arithmetic import select
from djpt.jit.llvm.ir import F32, I1, I32, Function, Type, Value, vector

__all__ = ["Packet", "PacketHits"]


class Packet:
    """The rays of a packet, in vectors; the function for it is being built."""

    def __init__(self, f: Function, any_hit: bool, features: Features, width: int) -> None:
        self.f, self.any_hit, self.features, self.width = f, any_hit, features, width
        self.valid, self.scene, _, self.rays = f.parameters
        self.row, self.words = vector(F32, width), vector(I32, width)
        self.o, self.d = lines_of(self.rays, width)
        self.active = f.load(self.words, self.valid, align=4) != 0

    def address(self, field: str | int) -> Value:
        """The address of one of the packet's arrays."""
        index = FIELDS[field] if isinstance(field, str) else field
        return self.rays.at(4 * self.width * index)

    def array(self, field: str | int, type: Type | None = None) -> Value:
        """The numbers of all lanes."""
        return self.f.load(type or self.row, self.address(field), align=self.row.size)

    def write(self, field: str | int, values: Value) -> None:
        """Write the numbers of all lanes."""
        self.f.store(values, self.address(field), align=self.row.size)


class PacketHits:
    """What the search for a packet has found."""

    def __init__(self, packet: Packet) -> None:
        f = self.f = packet.f
        self.packet = packet
        self.maxt = f.variable(packet.row, packet.array("maxt"))
        self.limit = f.variable(packet.row, select(packet.active, self.maxt.value, float("-inf")))
        """Where each ray ends, or its closest hit; negative where no hit is wanted any more."""
        fields = [] if packet.any_hit else [B1, B2, RECORD]
        self._found = {field: f.variable(packet.words, packet.array(field, packet.words)) for field in fields}
        self._flags = packet.array("flags", packet.words)

    def passes(self, record: Value) -> Value:
        """The rays that pass through the triangle at a record."""
        f, packet = self.f, self.packet
        passes = f.constant(vector(I1, packet.width), 0)
        if packet.features.lights:
            passes = packet.features.passed(f, packet.scene, record, self._flags)
        if packet.features.one_sided:
            passes = passes | packet.features.behind(f, packet.scene, record, packet.d)
        return passes

    def note(self, hit: Value, t: Value, weights: Sequence[Value], record: Value) -> None:
        """Note the closest hits of some rays so far: their distances `t`, the weights of corners, and the records."""
        if self.packet.any_hit:
            self.limit.value = select(hit, float("-inf"), self.limit.value)
            return
        found = [*(weight.bits_as(self.packet.words) for weight in weights), record]
        for variable, value in zip(self._found.values(), found, strict=True):
            variable.value = select(hit, value, variable.value)
        self.maxt.value = select(hit, t, self.maxt.value)
        ends = select((self._flags & ANY_HIT) != 0, float("-inf"), t)
        self.limit.value = select(hit, ends, self.limit.value)

    def write(self) -> None:
        """Write the results of all rays."""
        packet = self.packet
        if packet.any_hit:
            blocked = packet.active & (self.limit.value < 0.0)
            packet.write("maxt", select(blocked, BLOCKED, self.maxt.value))
            return
        closer = self.maxt.value < packet.array("maxt")
        packet.write(INSIDE, select(closer, 0, packet.array(INSIDE, packet.words)))
        packet.write("maxt", self.maxt.value)
        for field, found in self._found.items():
            packet.write(field, found.value)
