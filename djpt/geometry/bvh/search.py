"""Searching the BVH: for lanes that have a ray each, or for many rays in turn."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from djpt.geometry.bvh.records import EMPTY, Records
from djpt.geometry.bvh.traversal import STEPS, Cursor, Stepper, enter, start
from djpt.records import Ray3f
from djpt.lanewide import wide
from djpt.types import Bool, Float, Point3f, UInt32, Vector3f

__all__ = ["search"]

BATCH = 2**17
"""Rays in flight: lanes of a persistent loop. Eight blocks of Dr.Jit's, so that cores share them evenly."""


def search(records: Records, ray: Ray3f, any_hit: bool, active: Bool | bool = True) -> tuple[Float, UInt32]:
    """Distance and record of the first hit, or of any one; the record is NONE on a miss."""
    lanes = dr.width(ray, active)
    if lanes >= 2 * BATCH and not dr.flag(dr.JitFlag.SymbolicScope):
        return batched(records, ray, any_hit, active, lanes)
    origin, entry = enter(records, ray)
    stepper = Stepper(records, origin, ray.d)
    (end,) = dr.while_loop(
        (wide(start(records, ray.maxt - entry, active), lanes),),
        lambda cursor: cursor.current != EMPTY,
        lambda cursor: (stepper.step(cursor, any_hit),),
        label="any hit" if any_hit else "closest hit",
    )
    return end.t + entry, end.hit


@dataclass
class Flight:
    """Loop state of `batched`."""

    index: UInt32
    origin: Point3f
    d: Vector3f
    entry: Float
    cursor: Cursor


def batched(records: Records, ray: Ray3f, any_hit: bool, active: Bool | bool, lanes: int) -> tuple[Float, UInt32]:
    """The same for many rays: a lane that has finished takes the next ray.

    Traversals differ in length; with one ray per lane a packet would wait for its longest.
    """
    o, d, maxt, live = wide([ray.o, ray.d, ray.maxt, Bool(active)], lanes)
    dr.eval(o, d, maxt, live)
    count, stride = dr.opaque(UInt32, lanes), dr.opaque(UInt32, BATCH)
    t, record = dr.empty(Float, lanes), dr.empty(UInt32, lanes)

    def fetch(index: UInt32) -> Flight:
        inside = index < count
        ray = Ray3f(
            Point3f(*(dr.gather(Float, x, index, inside) for x in o)),
            Vector3f(*(dr.gather(Float, x, index, inside) for x in d)),
            dr.gather(Float, maxt, index, inside),
        )
        origin, entry = enter(records, ray)
        usable = inside & dr.gather(Bool, live, index, inside)
        return Flight(index, origin, ray.d, entry, start(records, ray.maxt - entry, usable))

    def land(flight: Flight) -> Flight:
        dr.scatter(t, flight.cursor.t + flight.entry, flight.index)
        dr.scatter(record, flight.cursor.hit, flight.index)
        return fetch(flight.index + stride)

    def turn(flight: Flight) -> tuple[Flight]:
        stepper = Stepper(records, flight.origin, flight.d)
        for _ in range(STEPS):
            flight.cursor = stepper.step(flight.cursor, any_hit)
        ended = flight.cursor.current == EMPTY
        (flight,) = dr.if_stmt((flight,), ended, lambda flight: (land(flight),), lambda flight: (flight,))
        return (flight,)

    first = wide(fetch(dr.arange(UInt32, BATCH)), BATCH)
    (end,) = dr.while_loop((first,), lambda flight: flight.index < count, turn, label="ray batch")
    dr.eval(end.index, t, record)
    return t, record
