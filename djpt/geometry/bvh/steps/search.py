"""The search of the BVH: by lanes that have a ray each, or by lanes that take one ray after the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.geometry.bvh.steps.approach import enter
from djpt.geometry.bvh.steps.records import EMPTY, Records
from djpt.geometry.bvh.steps.traversal import Cursor, start, turn, visit
from djpt.geometry.query import Found
from djpt.jit.kernels import if_stmt, while_loop, wide
from djpt.jit.types import ArrayXf, Bool, Float, Point3f, UInt32, Vector3f

__all__ = ["search"]

BATCH = 2**17
"""The lanes of a persistent loop: eight of Dr.Jit's blocks, which the cores share evenly."""


def search(
    records: Records, ray: Ray3f, any_hit: bool, active: Bool | bool = True, through_lights: Bool | None = None
) -> Found:
    """Find the first hit with 0 < t < maxt, or with `any_hit` any one."""
    lanes = dr.width(ray, active, through_lights)
    if lanes >= 2 * BATCH and through_lights is None and not dr.flag(dr.JitFlag.SymbolicScope):
        return batched(records, ray, any_hit, active, lanes)
    origin, entry = enter(records, ray)
    (end,) = while_loop(
        (wide(start(records, origin, ray.d, ray.maxt - entry, active), lanes),),
        lambda cursor: cursor.current != EMPTY,
        lambda cursor: (visit(records, cursor, origin, ray.d, Bool(any_hit), through_lights),),
        label="any hit" if any_hit else "closest hit",
    )
    return Found(origin, entry, end.t, end.hit, end.passage and end.passage.hit_inside)


def packed(records: Records, ray: Ray3f, active: Bool | bool, lanes: int) -> Float:
    """Write rays to memory, 8 numbers each for one packet load: origin near the triangles, direction, maxt, 0."""
    o, entry = enter(records, ray)
    # The cursor of a ray whose origin is NaN starts as finished.
    x = dr.select(active, o.x, dr.nan)
    rays = dr.empty(Float, 8 * lanes)
    values = wide([x, o.y, o.z, ray.d.x, ray.d.y, ray.d.z, ray.maxt - entry, Float(0)], lanes)
    dr.scatter(rays, ArrayXf(values), dr.arange(UInt32, lanes))
    dr.eval(rays)
    return rays


@dataclass
class Flight:
    """Loop state of `batched`."""

    index: UInt32
    origin: Point3f
    d: Vector3f
    cursor: Cursor


def batched(records: Records, ray: Ray3f, any_hit: bool, active: Bool | bool, lanes: int) -> Found:
    """Search for `lanes` rays by `BATCH` lanes: a lane that has finished takes the next ray.

    Traversals differ in length; with one ray per lane a packet would wait for its longest one.
    """
    rays = packed(records, ray, active, lanes)
    count, stride = dr.opaque(UInt32, lanes), dr.opaque(UInt32, BATCH)
    t, record = dr.empty(Float, lanes), dr.empty(UInt32, lanes)
    inside = dr.empty(UInt32, lanes) if records.instanced else None

    def fetch(index: UInt32) -> Flight:
        exists = index < count
        x: Any = dr.gather(ArrayXf, rays, index, exists, shape=(8, 1))
        o, d = Point3f(x[0], x[1], x[2]), Vector3f(x[3], x[4], x[5])
        return Flight(index, o, d, start(records, o, d, x[6], exists))

    def land(flight: Flight) -> Flight:
        dr.scatter(t, flight.cursor.t, flight.index)
        dr.scatter(record, flight.cursor.hit, flight.index)
        passage = flight.cursor.passage
        if inside is not None and passage is not None:
            dr.scatter(inside, passage.hit_inside, flight.index)
        return fetch(flight.index + stride)

    def body(flight: Flight) -> tuple[Flight]:
        flight.cursor = turn(records, flight.cursor, flight.origin, flight.d, Bool(any_hit))
        ended = flight.cursor.current == EMPTY
        (flight,) = if_stmt((flight,), ended, lambda flight: (land(flight),), lambda flight: (flight,))
        return (flight,)

    first = wide(fetch(dr.arange(UInt32, BATCH)), BATCH)
    (end,) = while_loop((first,), lambda flight: flight.index < count, body, label="ray batch")
    dr.eval(end.index, t, record, inside)
    return Found(*enter(records, ray), t, record, inside)
