"""The base of shapes that lie in a plane."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import cross_product
from djpt.jit.kernels import as_vector
from djpt.jit.types import Point2f, Point3f, Vector3f
from djpt.shapes.axes import SignedAxis
from djpt.shapes.base import Face, Shape

__all__ = ["FlatShape"]


class FlatShape(Shape):
    """A part of the local xy plane; the front is the side of the transformed +z axis, unless `flip_normals` is set."""

    center: Vector3f
    edge_u: Vector3f
    edge_v: Vector3f
    normal: Vector3f
    """The shading normal."""
    dual_u: Vector3f
    """dual_u . (p - center) is the local x coordinate, also for sheared shapes."""
    dual_v: Vector3f

    def lay(self) -> tuple[NDArray[np.float64], ...]:
        """Set the values above; gives normals, geometric and shading, the duals, and the cross product of the edges."""
        matrix = self.to_world.matrix
        center, u, v = matrix[:3, 3], matrix[:3, 0], matrix[:3, 1]
        cross = cross_product(u, v)
        normal = cross / np.linalg.norm(cross)
        dual_u, dual_v = cross_product(v, cross) / cross.dot(cross), cross_product(cross, u) / cross.dot(cross)
        # The geometric normal is dp/du x dp/dv, the shading normal lies on the side of local +z.
        self.mirrored = bool(normal.dot(matrix[:3, 2]) < 0)
        outward = -normal if self.flip_normals != self.mirrored else normal
        self._host: Any = (center, u, v, normal)
        self.center, self.edge_u, self.edge_v = as_vector(center), as_vector(u), as_vector(v)
        self.dual_u, self.dual_v = as_vector(dual_u), as_vector(dual_v)
        self.normal = as_vector(outward)
        return normal, outward, dual_u, dual_v, cross

    def plane(self) -> tuple[NDArray[np.float64], float] | None:
        center, _, _, normal = self._host
        return normal, float(center.dot(normal))

    def flat_face(self, tangent: SignedAxis) -> Face:
        """The face, if the first axis is that of the shading normal, and `tangent` that of dp/du."""
        outward = self._axes[0]
        return Face(SignedAxis(outward.axis, outward.negative ^ self.mirrored), outward, tangent)

    def local(self, p: Point3f) -> Point2f:
        """The local x and y of a point of the plane."""
        offset = p - self.center
        return Point2f(dr.dot(self.dual_u, offset), dr.dot(self.dual_v, offset))
