"""A ray on its way through a scene: loop state of the machine schedule."""

from __future__ import annotations

from dataclasses import dataclass

from djpt.geometry.bvh.traversal import Cursor
from djpt.records import Ray3f

__all__ = ["ANALYTIC", "Query"]

ANALYTIC = 0x80000000
"""Set in `Query.cursor.hit` where the number is that of a face of the unrolled set, not of a record."""


@dataclass
class Query:
    """A ray that has met the unrolled shapes, and how far it has come in the BVH."""

    ray: Ray3f
    cursor: Cursor
