"""The search among few faces: all of them are tested, one after the other, by all rays of a packet, in LLVM IR.

A room of some quadrilaterals and boxes has fewer faces than a tree of them has work: a search visits several nodes and
leaves, waits for each, and mispredicts branches. Here is nothing to wait for or to predict. A first loop shears each
corner into the frames of all rays, a second tests the faces, with the lanes of a vector for the rays. The test is that
of trees, and so are the hits.

The tables are those of `djpt.geometry.bvh.calls.faces`. Functions fit every scene, and edits.
"""

from __future__ import annotations

from djpt.geometry.bvh.calls.coherent import CoherentSearch
from djpt.geometry.bvh.calls.faces import CORNER_BYTES, FACE_BYTES, MOST_CORNERS
from djpt.geometry.bvh.calls.layout import FACES_WORD, ROW_BYTES
from djpt.geometry.bvh.calls.packet_hits import Packet, PacketHits
from djpt.geometry.bvh.calls.ray import AxisOrder, Features, RayTerms, TriangleTest, Triple, sheared
from djpt.geometry.bvh.calls.traversal import ANY, PACKET, name_of
from djpt.jit.llvm.arithmetic import select
from djpt.jit.llvm.ir import F32, I32, I64, Module, Value

__all__ = ["sweep_function"]

SECOND_AT, RECORDS_AT = 12, 24
"""The bytes of a face to the corners of its second triangle, and to the numbers of both."""


def sweep_function(kind: str, width: int, features: Features) -> str:
    """The search of a kind for packets of `width` rays among few faces, in LLVM's language.

    It has the name and parameters of `djpt.geometry.bvh.calls.traversal.packet_function`. Scenes with instances or
    solids in their tree have none.
    """
    module = Module()
    with module.function(name_of(kind), PACKET) as f:
        CoherentSearch(f, kind == ANY, features, width).build()
        Sweep(f, kind == ANY, features, width).build()
    return module.text()


class Sweep(Packet):
    """The search; the function for it is being built."""

    def build(self) -> None:
        """Test all faces, and write the results."""
        f = self.f
        row, corner_count, count = (f.load(I32, self.scene.at(4 * (FACES_WORD + k))).to(I64) for k in range(3))
        corners = self.scene.at(row * ROW_BYTES)
        faces = corners.at(corner_count * CORNER_BYTES)
        first_record = f.load(I32, self.scene)
        order, terms = AxisOrder.of(self.d), RayTerms.of(self.o, self.d)
        frames = f.array(self.row, 3 * MOST_CORNERS)
        with f.each(0, corner_count) as k:
            corner = corners.at(k * CORNER_BYTES)
            away = [f.load(F32, corner.at(4 * axis)).spread(self.width) - self.o[axis] for axis in range(3)]
            for axis, number in enumerate(sheared(order.apply(away), terms.shear)):
                frames[k * 3 + axis] = number
        hits = PacketHits(self)

        def test(address: Value) -> TriangleTest:
            numbers = [f.load(I32, address.at(4 * corner)).to(I64) * 3 for corner in range(3)]
            return TriangleTest.between(
                [Triple(*(frames[number + axis] for axis in range(3))) for number in numbers], terms.shear[2]
            )

        with f.each(0, count) as k:
            face = faces.at(k * FACE_BYTES)
            first, second = test(face), test(face.at(SECOND_AT))
            t, *weights = first.otherwise(second).distance()
            # No branch: whether any ray hits can't be predicted.
            hit = (first.inside | second.inside) & (t > 0.0) & (t < hits.limit.value)
            records = [f.load(I32, face.at(RECORDS_AT + 4 * k)) + first_record for k in range(2)]
            # Both triangles are of one mesh, and have the same normal.
            hit = hit & ~hits.passes(records[0])
            record = select(first.inside, *(number.spread(self.width) for number in records))
            hits.note(hit, t, weights, record)
        hits.write()
