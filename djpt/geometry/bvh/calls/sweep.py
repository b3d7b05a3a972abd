"""The search among few flat faces: all of them are tested, one after the other, by all rays of a packet, in LLVM IR.

A room of some quadrilaterals and boxes has fewer faces than a tree of them has work: a search visits several nodes and
leaves, waits for each, and mispredicts branches. Here is nothing to wait for or to predict. A loop runs over a table
in memory, with the lanes of a vector for the rays: where does a ray meet the plane of a face, and is that point inside
of all edges? Only at the end the triangle that was hit is found, and the weights of its corners.

The tables are those of `djpt.geometry.bvh.calls.faces`. Functions fit every scene, and edits.
"""

from __future__ import annotations

from djpt.geometry.bvh.calls.faces import FINISH_BYTES, TEST_BYTES
from djpt.geometry.bvh.calls.layout import FACES_WORD, PASSES_LIGHTS, ROW_BYTES
from djpt.geometry.bvh.calls.packet_hits import Packet, PacketHits
from djpt.geometry.bvh.calls.ray import Features
from djpt.geometry.bvh.calls.traversal import ANY, B1, B2, INSIDE, PACKET, RECORD, name_of
from djpt.jit.llvm.arithmetic import abs, any_of, fma, maximum, minimum, select
from djpt.jit.llvm.ir import F32, I32, I64, Module, Value

__all__ = ["sweep_function"]

EMITS_AT, NUMBERS_AT = 80, 80
"""The bytes to the last number of TEST, and to the numbers of triangles in FINISH."""


def sweep_function(kind: str, width: int, features: Features) -> str:
    """The search of a kind for packets of `width` rays among few faces, in LLVM's language.

    It has the name and parameters of `djpt.geometry.bvh.calls.traversal.packet_function`. Scenes with instances or
    solids in their tree have none.
    """
    module = Module()
    with module.function(name_of(kind), PACKET) as f:
        Sweep(f, kind == ANY, features, width).build()
    return module.text()


class Sweep(Packet):
    """The search; the function for it is being built."""

    def build(self) -> None:
        """Test all faces, and write the results."""
        f = self.f
        row, count = (f.load(I32, self.scene.at(4 * (FACES_WORD + k))).to(I64) for k in range(2))
        tests = self.scene.at(row * ROW_BYTES)
        finishes = tests.at(count * TEST_BYTES)
        first_record = f.load(I32, self.scene)
        hits = PacketHits(self, [] if self.any_hit else [RECORD])
        margin = f.load(F32, self.scene.at(4 * (FACES_WORD + 2))).spread(self.width)
        through = self.array("flags", self.words) & PASSES_LIGHTS
        index = f.variable(I64, 0)
        with f.loop() as turns:
            face = index.value
            turns.stop_if(face == count)
            index.value = face + 1
            hit, t = self.test(tests.at(face * TEST_BYTES), margin, hits.limit.value)
            number = face.to(I32).spread(self.width)
            # No branch: whether any ray hits can't be predicted.
            if self.features.lights:
                emits = f.load(I32, tests.at(face * TEST_BYTES).at(EMITS_AT)).spread(self.width)
                hit = hit & ((emits & through) == 0)
            if self.features.one_sided:
                with f.when(any_of(hit)):
                    # Both triangles of a face have the same normal.
                    record = first_record + f.load(I32, finishes.at(face * FINISH_BYTES).at(NUMBERS_AT))
                    behind = self.features.behind(f, self.scene, record, self.d)
                    hits.note(hit & ~behind, t, [number])
            else:
                hits.note(hit, t, [number])
        if not self.any_hit:
            found = f.array(I32, self.width)
            found.store((hits.maxt.value < self.array("maxt")).to(I32))
        hits.write()
        if not self.any_hit:
            with f.each(0, self.width) as lane, f.when(found[lane] != 0):
                self.finish(lane, finishes, first_record)

    def test(self, face: Value, margin: Value, limit: Value) -> tuple[Value, Value]:
        """The rays that hit a face, enlarged by a margin, before a `limit`, and where they meet its plane."""

        def number(k: int) -> Value:
            return self.f.load(F32, face.at(4 * k)).spread(self.width)

        def value(k: int, p: list[Value]) -> Value:
            return fma(number(k), p[0], fma(number(k + 1), p[1], fma(number(k + 2), p[2], number(k + 3))))

        slope = fma(number(0), self.d[0], fma(number(1), self.d[1], number(2) * self.d[2]))
        t = -value(0, self.o) / slope
        p = [fma(t, d, o) for o, d in zip(self.o, self.d, strict=True)]
        inside = minimum(minimum(value(4, p), value(8, p)), minimum(value(12, p), value(16, p)))
        return (fma(inside, abs(slope), margin) >= 0.0) & (t > 0.0) & (t < limit), t

    def finish(self, lane: Value, finishes: Value, first_record: Value) -> None:
        """Write the triangle that a ray has hit, and the weights of its corners."""
        f = self.f

        def place(field: str | int) -> Value:
            return self.address(field).at(lane * 4)

        finish = finishes.at(f.load(I32, place(RECORD)).to(I64) * FINISH_BYTES)
        t = f.load(F32, place("maxt"))
        p = [fma(t, f.load(F32, place(4 + axis)), f.load(F32, place(axis))) for axis in range(3)]

        def value(plane: Value) -> Value:
            x, y, z, c = (f.load(F32, plane.at(4 * k)) for k in range(4))
            return fma(x, p[0], fma(y, p[1], fma(z, p[2], c)))

        second = select(value(finish) >= 0.0, f.constant(I64, 0), f.constant(I64, 1))
        planes = finish.at(16).at(second * 32)
        b1 = minimum(maximum(value(planes), 0.0), 1.0)
        b2 = minimum(maximum(value(planes.at(16)), 0.0), 1.0 - b1)
        record = first_record + f.load(I32, finish.at(NUMBERS_AT).at(second * 4))
        f.prefetch(self.scene.at(record.to(I64) * ROW_BYTES))
        for word, field in ((b1, B1), (b2, B2), (record, RECORD), (f.constant(I32, 0), INSIDE)):
            f.store(word, place(field))
