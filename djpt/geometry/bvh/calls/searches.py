"""The searches of trees that kernels call: compiled at first use, proved, and called for every packet of lanes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import drjit as dr
import numpy as np

from djpt.geometry.bvh.build.builder import build
from djpt.geometry.bvh.calls.crossings import LENGTHS_OF_PACKET, crossing_function
from djpt.geometry.bvh.calls.layout import MEDIUM_BITS
from djpt.geometry.bvh.calls.pairs import DIRECTION, END, KEEP_ORIGINS, PAIRS, pair_functions
from djpt.geometry.bvh.calls.ray import Features
from djpt.geometry.bvh.calls.rings import ring_function
from djpt.geometry.bvh.calls.sweep import sweep_function
from djpt.geometry.bvh.calls.traversal import ANY, CLOSEST, FIELDS, name_of, packet_function
from djpt.jit.kernels import float_in
from djpt.jit.llvm.calls import Code, call, reason_against
from djpt.jit.llvm.compiler import compiled
from djpt.jit.llvm.lanes import instruction_set, lane_count, target
from djpt.jit.types import Bool, Float, Point3f, UInt32, Vector3f

__all__ = [
    "RINGS",
    "SEARCHES",
    "SWEEP",
    "Functions",
    "Met",
    "Proof",
    "call_any",
    "call_closest",
    "call_lengths",
    "call_pairs",
    "functions",
    "proof",
    "why_not",
]

# ---- calls -------------------------------------------------------------------------------------------------------


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


def call_pairs(
    keep: Code,
    pairs: Code,
    scene: UInt32,
    ray: tuple[Point3f, Vector3f, Float],
    to_light: tuple[Point3f, Vector3f, Float],
    followed: Bool,
    flags: UInt32,
) -> tuple[Met, Bool]:
    """`call_closest` for each `ray`, and `call_any` for the ray `to_light` where that is `followed`.

    Rays are their origins, directions and ends.
    """
    o, d, maxt = to_light
    kept = call(keep, scene, arguments(o, d, maxt, followed, UInt32(0)), [Bool(False)], any_hit=True)[0]
    end = dr.select(Bool(kept), dr.detach(maxt), 0)
    inputs: list[Any] = arguments(*ray, Bool(True), flags)
    d = dr.detach(d)
    rest: list[Float] = [d.x, d.y, d.z, end]
    for array, number in zip((*DIRECTION, END), rest, strict=True):
        inputs[BEFORE_ARRAYS + array] = number if array < FIELDS["flags"] else dr.reinterpret_array(UInt32, number)
    outputs: list[Any] = [Bool(False), Float(0), Float(0), Float(0), UInt32(0), UInt32(0), UInt32(0)]
    *met, hidden = call(pairs, scene, inputs, outputs)
    return Met(*met), Bool(hidden != 0)


BEFORE_ARRAYS = 2
"""The inputs of a call before those that become arrays of the packet, of which the last, from the flags on, are whole
numbers."""


def call_lengths(
    code: Code, scene: UInt32, o: Point3f, d: Vector3f, maxt: Float, active: Bool, medium: UInt32
) -> tuple[Bool, list[Float]]:
    """Measure rays up to `maxt` through media: see `CompiledTree.lengths`."""
    outputs: list[Any] = [Bool(False), Float(0), Float(0), Float(0), UInt32(0), UInt32(0)]
    inputs = arguments(o, d, maxt, active, medium << MEDIUM_BITS)
    found, first, second, third, fourth, blocked = call(code, scene, inputs, outputs)
    # Rays that aren't followed, such as those with NaN, meet nothing.
    lengths = [
        dr.select(found, length, dr.select(medium == number, maxt, 0))
        for number, length in enumerate((first, second, third, float_in(fourth)), 1)
    ]
    return Bool(found & (blocked != 0)), lengths


def arguments(o: Point3f, d: Vector3f, maxt: Float, active: Bool, flags: UInt32) -> list[Float | UInt32 | Bool]:
    """The inputs of a call, in Embree's order."""
    # A negative end would mean "blocked" when it comes back.
    o, d, maxt = dr.detach(o), dr.detach(d), dr.select(maxt > 0, dr.detach(maxt), 0)
    # A ray with NaN would meet all boxes, also those of missing children.
    reach = dr.abs(o.x) + dr.abs(o.y) + dr.abs(o.z)
    active = active & (reach < 1e18) & dr.isfinite(d.x + d.y + d.z)
    zero, unused = Float(0), UInt32(0)
    return [Bool(False), active, o.x, o.y, o.z, zero, d.x, d.y, d.z, zero, maxt, flags, unused, unused]


# ---- compiled functions ------------------------------------------------------------------------------------------


RINGS = "rings"
SEARCHES: dict[str, Callable[[str, int, Features], str]] = {RINGS: ring_function, "call": packet_function}
"""The searches in LLVM's language, the fastest first: of the rays of a packet side by side, or one after the other."""

SWEEP = "sweep"
"""The search among few faces, which no scene is asked for."""

FUNCTIONS = SEARCHES | {SWEEP: sweep_function}


@dataclass(frozen=True)
class Functions:
    """The compiled functions of a tree."""

    closest: Code
    any: Code
    pairs: tuple[Code, Code] | None = None
    """Those that search for two rays of each lane; None if the search can't."""
    lengths: Code | None = None
    """The one that measures media; None if no triangle is passable, or the search can't."""


@cache
def functions(features: Features, search: str, measures: bool = False) -> Functions:
    """The functions of one of `FUNCTIONS` for scenes with some features, compiled at the first call.

    If it `measures`, there is one that does, by rings; not for scenes with instances.
    """
    measures &= not features.instances
    lengths = Code.at(address_of_lengths(features)) if measures else None
    closest, any_hit, *pairs = (Code.at(address) for address in addresses(features, search))
    return Functions(closest, any_hit, (pairs[0], pairs[1]) if pairs and proof(search).pairs else None, lengths)


@cache
def addresses(features: Features, search: str) -> list[int]:
    """Where the functions for the closest hit and for any hit are in memory, then those for pairs of rays, if any.

    Rings have these, but not for scenes with solids in their trees, among which any hit is found faster alone.
    """
    width = lane_count()
    target()  # for which other threads may not be able to ask

    def search_of(kind: str) -> list[int]:
        found = compiled(FUNCTIONS[search](kind, width, features), (name_of(kind),))
        return [found[name_of(kind)]]

    def search_of_pairs() -> list[int]:
        found = compiled(pair_functions(width, features), (KEEP_ORIGINS, PAIRS))
        return [found[KEEP_ORIGINS], found[PAIRS]]

    with ThreadPoolExecutor(2) as team:
        parts = [team.submit(search_of, kind) for kind in (CLOSEST, ANY)]
        if search == RINGS and not features.kinds:
            parts.append(team.submit(search_of_pairs))
        return [address for part in parts for address in part.result()]


@cache
def address_of_lengths(features: Features) -> int:
    """Where the function that measures media is in memory."""
    return compiled(crossing_function(lane_count(), features), (LENGTHS_OF_PACKET,))[LENGTHS_OF_PACKET]


@cache
def why_not(search: str) -> str | None:
    """What stands against one of `SEARCHES` on this machine; None if it works.

    Found out at the first call, by rays whose hits are known.
    """
    if search == RINGS and instruction_set() not in RING_SETS:
        return "the processor, or Dr.Jit's packets, lack AVX2"
    return reason_against(lambda: proof(search).hits, "rays with known hits got other results")


RING_SETS = ("AVX-512", "AVX2")
"""The instruction sets by which vectors can be compressed."""


class Proof(NamedTuple):
    """What functions were proved to find."""

    hits: bool
    """The closest hits and any hits of rays."""
    pairs: bool
    """Both for two rays of each lane."""


@cache
def proof(search: str) -> Proof:
    """Let rays through a stack of triangles find the hits that follow from how it was made."""
    count, misses = 40, 3
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    # Triangle k lies at x = 2 k, in the plane z = k.
    corners = corner + np.arange(count, dtype=np.float32)[:, None, None] * np.array([2, 0, 1], np.float32)
    # Threads compile the functions that search and those that build.
    target()  # which other threads may not be able to ask for
    with ThreadPoolExecutor(1) as team:
        searches = team.submit(addresses, Features(), search)
        built = build(corners)
        searches.result()
    built.memory[0] = 0
    memory = UInt32(built.memory)
    closest, any_hit, *pair = (Code.at(address) for address in addresses(Features(), search))
    lane = dr.arange(UInt32, count + misses)
    exists = lane < count
    x, z = Float(2 * lane), Float(lane)
    center = Point3f(*(float(c) for c in built.extent.center))
    o, d = Point3f(x + 0.25, 0.5, z - 4) - center, Vector3f(0, 0, 2)
    met = call_closest(closest, memory, o, d, Float(dr.inf), Bool(True), UInt32(0))
    blocked = call_any(any_hit, memory, o, d, Float(2.5), lane != 1, UInt32(0))
    triangle = dr.gather(UInt32, UInt32(built.order), met.record, met.hit)
    right = (met.hit == exists) & (blocked == (exists & (lane != 1)))
    near = (abs(met.t - 2) < 1e-5) & (abs(met.b1 - 0.25) < 1e-5) & (abs(met.b2 - 0.5) < 1e-5)
    right &= near & (triangle == lane) & (met.inside == 0) | ~exists
    if not pair:
        return Proof(bool(dr.all(right)), False)
    far, moved = Float(dr.inf), o - Vector3f(0.125, 0, 0)
    again, hidden = call_pairs(pair[0], pair[1], memory, (o, d, far), (moved, d, Float(2.5)), lane != 1, UInt32(0))
    same = (again.t == met.t) & (again.record == met.record) | ~exists
    alike = (again.hit == met.hit) & (hidden == blocked) & same
    dr.eval(right, alike)
    return Proof(bool(dr.all(right)), bool(dr.all(alike)))
