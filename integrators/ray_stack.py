"""A stack of rays that wait their turn: for algorithms whose paths branch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.records import Ray3f
from djpt.types import Bool, Color3f, Float, Normal3f, Point3f, UInt32

__all__ = ["Branch", "RayStack"]


@dataclass
class Branch:
    """A ray to be followed, and what its light counts."""

    ray: Ray3f
    p: Point3f
    """The surface point that it leaves, before it was moved off the surface."""
    n: Normal3f
    """Geometric normal there."""
    throughput: Color3f
    """What its radiance is multiplied by."""
    bsdf_pdf: Float
    """Density of its direction; 0 if light sampling couldn't have found it (camera, delta)."""
    depth: UInt32
    """Surfaces before it."""
    body: UInt32
    """The absorbing body that it runs through: see `djpt.media.interior`."""


class RayStack:
    """Per lane: the last branch that was pushed is the first to be popped.

    The branches lie in memory of the lane's own; how many there are belongs to the state of the loop.
    """

    def __init__(self, capacity: int) -> None:
        self._memory: Any = dr.alloc_local(Branch, max(1, capacity))

    def push(self, size: UInt32, branch: Branch, active: Bool) -> UInt32:
        """The size with one branch more, where `active`. It must fit."""
        self._memory.write(branch, size, active)
        return dr.select(active, size + 1, size)

    def pop(self, size: UInt32, active: Bool) -> tuple[UInt32, Branch, Bool]:
        """The size with one branch less, that branch, and where there was one; elsewhere nothing changes."""
        some = active & (size > 0)
        size = dr.select(some, size - 1, size)
        return size, self._memory.read(size, some), some
