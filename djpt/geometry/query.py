"""A ray on its way through a scene: loop state of the machine schedule."""

from __future__ import annotations

from dataclasses import dataclass

from djpt.geometry.bvh.traversal import Cursor
from djpt.types import Float, Point2f, Point3f, UInt32, Vector3f

__all__ = ["ANALYTIC", "FACE", "Near", "Query"]

ANALYTIC = 0x80000000
"""A bit of `Query.cursor.hit`: set where the rest is the number of an unrolled face, not of a record."""

FACE = 0x7FFFFFFF
"""The bits of `Query.cursor.hit` that hold the number of an unrolled face."""


@dataclass
class Near:
    """A hit as the search for triangles gives it."""

    origin: Point3f
    """The ray's origin, moved near the triangles: see `djpt.geometry.bvh.traversal.enter`."""
    t: Float
    """The distance from `origin`: exact also where the distance from a far origin would be rounded."""
    entry: Float | None
    """How far the origin was moved, in units of the ray's `d`; None: not at all."""
    b: Point2f | None
    """Barycentric weights of the second and third corner, if they are known."""
    inside: UInt32 | None
    """The record of the instance that the triangle belongs to; None in scenes without instances."""


@dataclass
class Query:
    """A ray that has met the unrolled shapes, and how far it has come in the BVH."""

    o: Point3f
    """The origin, near the triangles, as seen from the centre of the BVH."""
    d: Vector3f
    entry: Float | None
    """The distance of `o` from the ray's own origin, in units of `d`; None: the origin wasn't moved."""
    cursor: Cursor
