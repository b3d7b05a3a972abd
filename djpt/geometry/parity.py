"""The test whether a point lies inside of closed shapes, by counting crossings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr

from djpt.core.lookup import Members
from djpt.core.records import RAY_EPSILON, Ray3f
from djpt.geometry.aggregate import Geometry
from djpt.jit.kernels import while_loop, wide
from djpt.jit.types import Bool, Point3f, UInt32, Vector3f

__all__ = ["closed_shapes", "is_inside"]

DIRECTION = (0.3651484, 0.5477226, 0.7527727)
"""The direction of the rays, arbitrary but not along an axis, where rays would run within the faces of boxes."""


@dataclass
class Walk:
    """A ray on its way out of the scene, and the crossings so far: loop state."""

    o: Point3f
    crossings: UInt32
    active: Bool


def closed_shapes(geometry: Geometry) -> list[int]:
    """The indices of shapes that have an inside: meshes whose edges all pair up, and the closed analytic ones."""
    return [i for i, shape in enumerate(geometry.contents.shapes) if shape.is_closed()]


def is_inside(geometry: Geometry, p: Point3f, active: Bool | bool = True, shapes: Sequence[int] | None = None) -> Bool:
    """Whether a point lies within an odd number of closed surfaces: of `shapes` (indices), or of all closed ones.

    A ray from an inner point crosses a closed surface an odd number of times (the Jordan-Brouwer theorem);
    crossings of open shapes don't count. After each crossing the ray starts again RAY_EPSILON (1 + max abs(p))
    further on, so thinner walls may be missed.
    """
    inner = closed_shapes(geometry) if shapes is None else shapes
    count = len(geometry.contents.shapes)
    if not inner:
        return Bool(active) & Bool(False)
    closed, direction = Members(inner, count), Vector3f(*DIRECTION)

    def step(walk: Walk) -> tuple[Walk]:
        ray = Ray3f(walk.o, direction)
        hit = geometry.closest(ray)
        found = hit.is_valid() & walk.active
        crossings = walk.crossings + dr.select(found & closed.contain(hit.shape_index), UInt32(1), 0)
        there = ray(dr.select(found, hit.t, 0))
        on = dr.fma(direction, RAY_EPSILON * (1 + dr.max(dr.abs(there))), there)
        return (Walk(on, crossings, found),)

    start = wide(Walk(Point3f(p), UInt32(0), Bool(active)), dr.width(p, active))
    (end,) = while_loop((start,), lambda walk: walk.active, step, label="inside")
    return (end.crossings & 1) == 1
