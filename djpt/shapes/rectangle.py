"""The rectangle [-1, 1]^2 in the local xy plane, normal +z; any affine image of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import PositionSample3f
from djpt.description.plugin import HIDDEN
from djpt.description.registry import register_shape
from djpt.jit.kernels import as_float
from djpt.jit.types import Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.axes import AxisPool, ProjectedRay
from djpt.shapes.base import Face, Hit
from djpt.shapes.flat import FlatShape
from djpt.shapes.mitsuba_api import ShapeType

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.base import Silhouette

__all__ = ["Rectangle"]


class Rectangle(FlatShape):
    """A parallelogram with uv = ((x + 1) / 2, (y + 1) / 2).

    Parameters: `to_world` (affine, default identity), `flip_normals` (default false).
    The front, where the shading normal points and light is emitted, is the side of the transformed +z axis.
    """

    in_any_frame = True
    shape_kind = ShapeType.Rectangle
    triangle_count = 2
    has_parameterization = True
    canonical = "rectangle"
    values = dict.fromkeys(("center", "edge_u", "edge_v", "normal", "area", "dual_u", "dual_v"), HIDDEN)
    statics = ("flip_normals",)

    def place(self, pool: AxisPool) -> None:
        _, outward, dual_u, dual_v, cross = self.lay()
        center, u, _, _ = self._host
        self._axes = pool.find((outward, dual_u, dual_v, u), self._axes)
        axis_n, axis_u, axis_v = (signed.axis.direction for signed in self._axes[:3])
        self.plane_offset = as_float(center.dot(axis_n))
        self.center_u, self.half_u = as_float(center.dot(axis_u)), as_float(float(1 / np.linalg.norm(dual_u)))
        self.center_v, self.half_v = as_float(center.dot(axis_v)), as_float(float(1 / np.linalg.norm(dual_v)))
        self.area = as_float(float(4 * np.linalg.norm(cross)))

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        center, u, v, _ = self._host
        middle, reach = center.dot(direction), abs(u.dot(direction)) + abs(v.dot(direction))
        return float(middle - reach), float(middle + reach)

    def faces(self) -> Sequence[Face]:
        return [self.flat_face(self._axes[3])]

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        o_n, _, inv_n = ray.onto(self._axes[0].axis)
        o_u, d_u, _ = ray.onto(self._axes[1].axis)
        o_v, d_v, _ = ray.onto(self._axes[2].axis)
        t = (self.plane_offset - o_n) * inv_n
        inside_u = dr.abs(dr.fma(d_u, t, o_u) - self.center_u) <= self.half_u
        inside_v = dr.abs(dr.fma(d_v, t, o_v) - self.center_v) <= self.half_v
        return Hit(inside_u & inside_v & (t > 0) & (t < maxt), t, UInt32(numbers[0]))

    def draw_point(self, sample: Point2f) -> PositionSample3f:
        x, y = dr.fma(2, sample.x, -1), dr.fma(2, sample.y, -1)
        p = dr.fma(self.edge_u, x, dr.fma(self.edge_v, y, self.center))
        return PositionSample3f.of(p, self.normal, sample, dr.rcp(self.area))

    def at_uv(self, uv: Point2f) -> PositionSample3f:
        return self.draw_point(uv)

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        return Point2f(dr.fma(0.5, self.local(p), 0.5)), 2 * self.edge_u, 2 * self.edge_v

    def triangle(self, face: UInt32, uv: Point2f) -> UInt32:
        # Two triangles, cut along the diagonal u + v = 1.
        return dr.select(uv.x + uv.y > 1, UInt32(1), UInt32(0))

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.rectangle import RectangleSilhouette

        return RectangleSilhouette


register_shape("rectangle", Rectangle)
