"""A ray on its way through a scene: loop state of the machine schedule."""

from __future__ import annotations

from dataclasses import dataclass

from djpt.geometry.bvh.traversal import Cursor
from djpt.types import Float, Point2f, Point3f, UInt32, Vector3f

__all__ = ["ANALYTIC", "FACE", "Near", "Query"]

ANALYTIC = 0x80000000
"""Set in `Query.cursor.hit` where the number is that of a face of the unrolled set, not of a record."""

FACE = 0x7FFFFFFF
"""The rest of it."""


@dataclass
class Near:
    """A hit as the search for triangles sees it."""

    origin: Point3f
    """The ray's origin, moved near the triangles: see `djpt.geometry.bvh.traversal.enter`."""
    t: Float
    """The distance from there: exact where the ray's own origin is so far off that its distance isn't."""
    entry: Float | None
    """How far it was moved, in units of the ray's `d`; None: not at all."""
    b: Point2f | None
    """Barycentric weights of the second and third corner, if they are known."""
    inside: UInt32 | None
    """In scenes with instances: the record of that which the triangle belongs to."""


@dataclass
class Query:
    """A ray that has met the unrolled shapes, and how far it has come in the BVH."""

    o: Point3f
    """The origin, near the triangles, as seen from the centre of the BVH."""
    d: Vector3f
    entry: Float | None
    """How far from the ray's own origin that is, in units of `d`; None: not at all."""
    cursor: Cursor
