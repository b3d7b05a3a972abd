"""The searches of a tree as kernels call them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.jit.llvm.calls import Code, call
from djpt.jit.types import Bool, Float, Point3f, UInt32, Vector3f

__all__ = ["Met", "call_any", "call_closest"]


@dataclass
class Met:
    """The results of a search."""

    hit: Bool
    t: Float
    """The distance; infinity on a miss."""
    b1: Float
    b2: Float
    record: UInt32
    inside: UInt32
    """The record of the instance that the hit belongs to, 0 if none."""


def call_closest(code: Code, scene: UInt32, o: Point3f, d: Vector3f, maxt: Float, active: Bool, flags: UInt32) -> Met:
    """Find the first hit with 0 < t < maxt of each active lane's ray."""
    outputs: list[Any] = [Bool(False), Float(0), Float(0), Float(0), UInt32(0), UInt32(0)]
    return Met(*call(code, scene, arguments(o, d, maxt, active, flags), outputs))


def call_any(code: Code, scene: UInt32, o: Point3f, d: Vector3f, maxt: Float, active: Bool, flags: UInt32) -> Bool:
    """Whether each active lane's ray has a hit with 0 < t < maxt."""
    return Bool(call(code, scene, arguments(o, d, maxt, active, flags), [Bool(False)], any_hit=True)[0])


def arguments(o: Point3f, d: Vector3f, maxt: Float, active: Bool, flags: UInt32) -> list[Float | UInt32 | Bool]:
    """The inputs of a call, in Embree's order."""
    # A negative end would mean "blocked" when it comes back.
    o, d, maxt = dr.detach(o), dr.detach(d), dr.select(maxt > 0, dr.detach(maxt), 0)
    # A ray with NaN would meet all boxes, also those of missing children.
    reach = dr.abs(o.x) + dr.abs(o.y) + dr.abs(o.z)
    active = active & (reach < 1e18) & dr.isfinite(d.x + d.y + d.z)
    zero, unused = Float(0), UInt32(0)
    return [Bool(False), active, o.x, o.y, o.z, zero, d.x, d.y, d.z, zero, maxt, flags, unused, unused]
