"""Ray queries that tell the surfaces that light may pass straight through from all others."""

from __future__ import annotations

from collections.abc import Sequence

from djpt.core.records import PreliminaryIntersection3f, Ray3f
from djpt.geometry.aggregate import Geometry
from djpt.jit.types import Bool

__all__ = ["PassableSurfaces"]


class PassableSurfaces:
    """The passable shapes of a scene, if all of them are unrolled.

    Whether something opaque stands in the way of a shadow ray is then one query without an order, as in scenes without
    passable shapes, and the way through the few that are passable needs none of the other shapes.
    """

    def __init__(self, geometry: Geometry, passable: Sequence[bool]) -> None:
        """`passable` says of each shape in `geometry.contents.shapes` whether light may pass straight through."""
        self._geometry = geometry
        self._passable = [passable[i] for i in geometry.analytic_shapes]
        self._opaque = [not passes for passes in self._passable]
        self.are_apart = sum(self._passable) == sum(passable)
        """Whether all passable shapes are unrolled: only then the queries mean something."""

    def blocked(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        """Whether an opaque shape is hit with 0 < t < maxt."""
        hit = self._geometry.unrolled.any_hit(ray, active, self._opaque)
        triangles = self._geometry.triangles
        return hit if triangles is None else hit | triangles.occluded(ray, ~hit & active)

    def closest(self, ray: Ray3f) -> PreliminaryIntersection3f:
        """The first hit of a passable shape with 0 < t < maxt."""
        t, face = self._geometry.unrolled.closest(ray, among=self._passable)
        return PreliminaryIntersection3f.found(t, face, self._geometry.shape_of(face))
