"""What the silhouettes of flat shapes, disks and rectangles, have in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.silhouettes.base import PERIMETER, Placement, Silhouette, SurfacePoint, aligned, edge_normal
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["FlatSilhouette"]


class FlatSilhouette(Silhouette):
    """The rim of a plane shape that is the image of a unit shape in the plane z = 0."""

    def _on_perimeter(
        self, outward: Vector3f, along: Vector3f, uv: Point2f, direction: Callable[[Point3f], Vector3f], flags: int
    ) -> tuple[SilhouetteSample3f, Float]:
        """The point of the rim that lies `outward` of the centre, and the length of the tangent `along`.

        Its direction is `direction` of the point.
        """
        p = self.shape.center + outward
        speed = dr.norm(along)
        d = direction(p)
        tangent = along / speed
        ss = self.sample_of(
            p=p,
            n=edge_normal(d, tangent, -outward),
            uv=uv,
            discontinuity_type=UInt32(PERIMETER),
            flags=UInt32(flags),
            d=d,
            silhouette_d=tangent,
        )
        return ss, speed

    def place(self) -> Placement:
        shape = self.shape
        return Placement(shape.edge_u, shape.edge_v, shape.normal, shape.center)

    def surface(self, place: Any, p: Point3f, prim_index: UInt32, active: Bool | bool) -> SurfacePoint:
        n = aligned(place.up(), self.shape.normal)
        x, y = place.local(p)
        return SurfacePoint(n, n, self.uv_at(x, y), self.along_u(place, x, y))

    def uv_at(self, x: Float, y: Float) -> Point2f:
        """The texture coordinates of a point of the unit shape."""
        raise NotImplementedError

    def along_u(self, place: Placement, x: Float, y: Float) -> Vector3f:
        """The change of a point of the shape per unit of u."""
        raise NotImplementedError
