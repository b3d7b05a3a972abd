"""A stack of rays that wait their turn: for algorithms whose paths branch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f, Reference
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point3f, UInt32, Vector3f

__all__ = ["Branch", "RayStack", "branch", "camera_branch"]


@dataclass
class Branch:
    """A ray to be followed, and the weight of its light."""

    o: Point3f
    d: Vector3f
    maxt: Float
    medium: UInt32
    """The medium that the ray runs through; any number in scenes without media."""
    p: Point3f
    """The surface point that it leaves, before it was moved off the surface."""
    n: Normal3f
    """Geometric normal at `p`."""
    throughput: Color3f
    """The factor of its radiance in the image."""
    bsdf_pdf: Float
    """Density of its direction; 0 if light sampling couldn't have found it (camera, delta)."""
    depth: UInt32
    """The number of surfaces before this ray."""
    time: Float

    @property
    def ray(self) -> Ray3f:
        """The ray."""
        return Ray3f(self.o, self.d, maxt=self.maxt, time=self.time, medium=self.medium)

    @property
    def reference(self) -> Reference:
        """The surface point that the ray leaves, as the reference point of light sampling."""
        return Reference(self.p, self.n)


def camera_branch(ray: Ray3f) -> Branch:
    """The branch that a camera ray begins."""
    return branch(ray, ray.o, Normal3f(0), Color3f(1), Float(0), UInt32(0))


def branch(ray: Ray3f, p: Point3f, n: Normal3f, throughput: Color3f, bsdf_pdf: Float, depth: UInt32) -> Branch:
    """A branch that `ray` begins; see `Branch` for the rest."""
    medium = UInt32(0) if ray.medium is None else ray.medium
    return Branch(ray.o, ray.d, ray.maxt, medium, p, n, throughput, bsdf_pdf, depth, ray.time)


class RayStack:
    """A stack of branches for each lane.

    The branches lie in memory of the lane's own, of a size that a kernel must know: other than for single paths, depths
    are structure here. How many branches there are belongs to the state of the loop.
    """

    def __init__(self, capacity: int) -> None:
        self._memory: Any = dr.alloc_local(Branch, max(1, capacity))

    def push(self, size: UInt32, branch: Branch, active: Bool) -> UInt32:
        """Push a branch where `active`, if there is room, and return the new size."""
        self._memory.write(branch, size, active)
        return dr.select(active, size + 1, size)

    def pop(self, size: UInt32, active: Bool) -> tuple[UInt32, Branch, Bool]:
        """Pop a branch where `active`, and return the new size, the branch, and where there was one."""
        some = active & (size > 0)
        size = dr.select(some, size - 1, size)
        return size, self._memory.read(size, some), some
