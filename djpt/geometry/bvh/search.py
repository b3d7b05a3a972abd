"""Searching the BVH: for lanes that have a ray each, or for many rays in turn."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.geometry.bvh.records import EMPTY, Records
from djpt.geometry.bvh.traversal import STEPS, Cursor, Stepper, start
from djpt.records import Ray3f
from djpt.lanewide import wide
from djpt.types import Bool, Float, UInt32

__all__ = ["search"]

BATCH = 2**17
"""Rays in flight: lanes of a persistent loop. Eight blocks of Dr.Jit's, so that cores share them evenly."""


def search(records: Records, ray: Ray3f, any_hit: bool, active: Bool | bool = True) -> tuple[Float, UInt32]:
    """Distance and record of the first hit, or of any one; the record is NONE on a miss."""
    lanes = dr.width(ray, active)
    if lanes >= 2 * BATCH and not dr.flag(dr.JitFlag.SymbolicScope):
        return batched(records, ray, any_hit, active, lanes)
    stepper = Stepper(records, ray.o, ray.d)
    (end,) = dr.while_loop(
        (wide(start(records, ray.maxt, active), lanes),),
        lambda cursor: cursor.current != EMPTY,
        lambda cursor: (stepper.step(cursor, any_hit),),
        label="any hit" if any_hit else "closest hit",
    )
    return end.t, end.hit


def batched(records: Records, ray: Ray3f, any_hit: bool, active: Bool | bool, lanes: int) -> tuple[Float, UInt32]:
    """The same for many rays: a lane that has finished takes the next ray.

    Traversals differ in length; with one ray per lane a packet would wait for its longest.
    """
    o, d, maxt, live = wide([ray.o, ray.d, ray.maxt, Bool(active)], lanes)
    dr.eval(o, d, maxt, live)
    count, stride = dr.opaque(UInt32, lanes), dr.opaque(UInt32, BATCH)
    t, record = dr.empty(Float, lanes), dr.empty(UInt32, lanes)

    def fetch(index: UInt32) -> tuple[Ray3f, Bool]:
        inside = index < count
        ray = Ray3f(
            type(o)(*(dr.gather(Float, x, index, inside) for x in o)),
            type(d)(*(dr.gather(Float, x, index, inside) for x in d)),
            dr.gather(Float, maxt, index, inside),
        )
        return ray, inside & dr.gather(Bool, live, index, inside)

    index = dr.arange(UInt32, BATCH)
    first, usable = fetch(index)
    state: Any = (index, first, wide(start(records, first.maxt, usable), BATCH))

    def finish(index: UInt32, ray: Ray3f, cursor: Cursor) -> Any:
        dr.scatter(t, cursor.t, index)
        dr.scatter(record, cursor.hit, index)
        following = index + stride
        ray, usable = fetch(following)
        return following, ray, start(records, ray.maxt, usable)

    def turn(index: UInt32, ray: Ray3f, cursor: Cursor) -> Any:
        stepper = Stepper(records, ray.o, ray.d)
        for _ in range(STEPS):
            cursor = stepper.step(cursor, any_hit)
        ended = cursor.current == EMPTY
        return dr.if_stmt((index, ray, cursor), ended, finish, lambda *x: x)

    end = dr.while_loop(state, lambda index, ray, cursor: index < count, turn, label="ray batch")
    dr.eval(end[0], t, record)
    return t, record
