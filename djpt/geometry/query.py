"""A ray on its way through a scene: loop state of the machine schedule."""

from __future__ import annotations

from dataclasses import dataclass

from djpt.geometry.bvh.traversal import Cursor
from djpt.types import Float, Point3f, Vector3f

__all__ = ["ANALYTIC", "FACE", "Query"]

ANALYTIC = 0x80000000
"""Set in `Query.cursor.hit` where the number is that of a face of the unrolled set, not of a record."""

FACE = 0x7FFFFFFF
"""The rest of it."""


@dataclass
class Query:
    """A ray that has met the unrolled shapes, and how far it has come in the BVH."""

    o: Point3f
    """The origin, near the triangles, as seen from the centre of the BVH."""
    d: Vector3f
    entry: Float
    """How far from the ray's own origin that is."""
    cursor: Cursor
