"""Trees whose searches are calls of compiled functions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.geometry.bvh.calls.calls import call_any, call_closest
from djpt.geometry.bvh.calls.layout import ANY_HIT, PASSES_LIGHTS, ROW_WORDS
from djpt.geometry.bvh.steps.approach import enter
from djpt.geometry.query import NONE, Found
from djpt.jit.llvm.calls import Code
from djpt.jit.types import ArrayXu, Bool, Float, Point2f, Point3f, UInt32, Vector3f

__all__ = ["CompiledTree", "Functions"]


@dataclass(frozen=True)
class Functions:
    """The compiled functions of a tree."""

    closest: Code
    any: Code


@dataclass
class Progress:
    """How far a search has come: it begins and ends with one call. Loop state."""

    t: Float
    hit: UInt32
    waits: Bool
    """True where the call is still to come."""
    b: Point2f | None
    inside: UInt32 | None

    @property
    def ended(self) -> Bool:
        """True where the search has come to its end."""
        return ~self.waits


@dataclass
class CompiledTree:
    """A tree in one block of memory: see `djpt.geometry.bvh.calls.layout`. The contract is `RayTree`."""

    memory: UInt32
    functions: Functions
    center: Point3f
    radius: Float
    extent: float
    instanced: bool
    kinds: tuple[int, ...]
    stepwise: bool = False

    @property
    def bytes(self) -> int:
        return 4 * dr.width(self.memory)

    def search(
        self, ray: Ray3f, any_hit: bool, active: Bool | bool = True, through_lights: Bool | None = None
    ) -> Found:
        origin, entry = enter(self, ray)
        maxt, flags = ray.maxt - entry, flags_of(None, through_lights)
        if any_hit:
            hit = call_any(self.functions.any, self.memory, origin, ray.d, maxt, Bool(active), flags)
            return Found(origin, entry, maxt, dr.select(hit, UInt32(1), NONE), None)
        met = call_closest(self.functions.closest, self.memory, origin, ray.d, maxt, Bool(active), flags)
        inside = dr.select(met.hit, met.inside, NONE) if self.instanced else None
        b = Point2f(met.b1, met.b2)
        return Found(origin, entry, dr.select(met.hit, met.t, maxt), dr.select(met.hit, met.record, NONE), inside, b)

    def start(
        self, o: Point3f, d: Vector3f, maxt: Float, active: Bool | bool, hit: UInt32 | int, weights: bool
    ) -> Progress:
        inside = UInt32(NONE) if self.instanced else None
        return Progress(Float(maxt), UInt32(hit), Bool(active), Point2f(0) if weights else None, inside)

    def turn(self, cursor: Progress, o: Point3f, d: Vector3f, any_hit: Bool, through_lights: Bool | None) -> Progress:
        flags = flags_of(any_hit, through_lights)
        met = call_closest(self.functions.closest, self.memory, o, d, cursor.t, cursor.waits, flags)
        return Progress(
            # Whether there is any hit is told by a finite distance.
            dr.select(met.hit, dr.select(any_hit, 0, met.t), cursor.t),
            dr.select(met.hit, met.record, cursor.hit),
            cursor.waits & False,
            None if cursor.b is None else dr.select(met.hit, Point2f(met.b1, met.b2), cursor.b),
            None if cursor.inside is None else dr.select(met.hit, met.inside, cursor.inside),
        )

    def row(self, record: UInt32) -> list[UInt32]:
        words: Any = dr.gather(ArrayXu, self.memory, record, shape=(ROW_WORDS, 1))
        return list(words)

    def word(self, record: UInt32, index: int, active: Bool | bool = True) -> UInt32:
        word: UInt32 = dr.gather(UInt32, self.memory, record * ROW_WORDS + index, active)
        return word

    def map_rows(self, record: UInt32) -> list[UInt32]:
        # Where there is no record, any row will do.
        return [*self.row(dr.select(record == NONE, NONE, record - 1)), *self.row(record)]

    def corners(self, record: UInt32) -> None:
        return None


def flags_of(any_hit: Bool | None, through_lights: Bool | None) -> UInt32:
    """The flags of rays."""
    flags = UInt32(0)
    if any_hit is not None:
        flags |= dr.select(any_hit, UInt32(ANY_HIT), 0)
    if through_lights is not None:
        flags |= dr.select(through_lights, UInt32(PASSES_LIGHTS), 0)
    return flags
