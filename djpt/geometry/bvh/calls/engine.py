"""The compiled functions of a process, and the proof that kernels can call them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import drjit as dr
import numpy as np

from djpt.geometry.bvh.build.builder import build
from djpt.geometry.bvh.calls.calls import call_any, call_closest
from djpt.geometry.bvh.calls.packets import ANY_OF_PACKET, CLOSEST_OF_PACKET, packet_functions
from djpt.geometry.bvh.calls.placed import Features
from djpt.geometry.bvh.calls.tree import Functions
from djpt.jit.llvm.calls import Code, reason_against
from djpt.jit.llvm.compiler import compiled
from djpt.jit.llvm.lanes import lane_count, target
from djpt.jit.types import Bool, Float, Point3f, UInt32, Vector3f

__all__ = ["functions", "why_not"]


@cache
def functions(features: Features) -> Functions:
    """The functions for scenes with some features, compiled at the first call."""
    return Functions(*(Code.at(address) for address in addresses(features)))


@cache
def addresses(features: Features) -> tuple[int, int]:
    """Where the functions for the closest hit and for any hit are in memory."""
    found = compiled(packet_functions(lane_count(), features), (CLOSEST_OF_PACKET, ANY_OF_PACKET))
    return found[CLOSEST_OF_PACKET], found[ANY_OF_PACKET]


@cache
def why_not() -> str | None:
    """What stands against compiled ray queries on this machine; None if they work.

    Found out at the first call, by rays whose hits are known.
    """
    return reason_against(proved, "rays with known hits got other results")


def proved() -> bool:
    """Whether rays through a stack of triangles get the hits that follow from how it was made."""
    count, misses = 40, 3
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    # Triangle k lies at x = 2 k, in the plane z = k.
    corners = corner + np.arange(count, dtype=np.float32)[:, None, None] * np.array([2, 0, 1], np.float32)
    # Threads compile the functions that search and those that build.
    target()  # which other threads may not be able to ask for
    with ThreadPoolExecutor(1) as team:
        searches = team.submit(addresses, Features())
        built = build(corners)
        searches.result()
    built.memory[0] = 0
    memory, own = UInt32(built.memory), functions(Features())
    lane = dr.arange(UInt32, count + misses)
    exists = lane < count
    x, z = Float(2 * lane), Float(lane)
    center = Point3f(*(float(c) for c in built.extent.center))
    o, d = Point3f(x + 0.25, 0.5, z - 4) - center, Vector3f(0, 0, 2)
    met = call_closest(own.closest, memory, o, d, Float(dr.inf), Bool(True), UInt32(0))
    blocked = call_any(own.any, memory, o, d, Float(2.5), lane != 1, UInt32(0))
    triangle = dr.gather(UInt32, UInt32(built.order), met.record, met.hit)
    right = (met.hit == exists) & (blocked == (exists & (lane != 1)))
    near = (abs(met.t - 2) < 1e-5) & (abs(met.b1 - 0.25) < 1e-5) & (abs(met.b2 - 0.5) < 1e-5)
    return bool(dr.all(right & (near & (triangle == lane) & (met.inside == 0) | ~exists)))
