"""The unit disk in the local xy plane, normal +z; any affine image of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import PositionSample3f
from djpt.core.warp import square_to_uniform_disk_concentric
from djpt.description.plugin import HIDDEN
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.axes import AxisPool, ProjectedRay
from djpt.shapes.base import Hit
from djpt.shapes.flat import FlatShape
from djpt.shapes.mitsuba_api import ShapeType

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.base import Silhouette

__all__ = ["Disk"]


class Disk(FlatShape):
    """A disk or an ellipse with uv = (r, phi / 2 pi) in local polar coordinates.

    Parameters: `to_world` (affine, default identity), `flip_normals` (default false).
    The front, where light is emitted, is the side of the transformed +z axis; dp/du points away from the centre.
    """

    in_any_frame = True
    shape_kind = ShapeType.Disk
    has_parameterization = True
    canonical = "disk"
    values = dict.fromkeys(("center", "edge_u", "edge_v", "normal", "area", "dual_u", "dual_v"), HIDDEN)
    statics = ()

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self._round = True

    # ---- on the host ---------------------------------------------------------------

    def place(self, pool: AxisPool) -> None:
        normal, _, dual_u, dual_v, cross = self.lay()
        center, u, v, _ = self._host
        radius = float(np.linalg.norm(u))
        circle = abs(np.linalg.norm(v) / radius - 1) < 1e-6 and abs(u.dot(v)) < 1e-6 * radius**2
        # Once an ellipse, always treated as one: edits forth and back compile one kernel.
        self._round &= bool(circle)
        directions = (normal,) if self._round else (normal, dual_u, dual_v)
        previous = self._axes if self._axes is not None and len(self._axes) == len(directions) else None
        self._axes = pool.find(directions, previous)
        self.area = as_float(math.pi * float(np.linalg.norm(cross)))
        self.plane_offset = as_float(float(center.dot(self._axes[0].axis.direction)))
        self.radius_squared = as_float(radius**2)
        if not self._round:
            axis_u, axis_v = (signed.axis.direction for signed in self._axes[1:])
            self.center_u, self.scale_u = as_float(float(center.dot(axis_u))), as_float(float(np.linalg.norm(dual_u)))
            self.center_v, self.scale_v = as_float(float(center.dot(axis_v))), as_float(float(np.linalg.norm(dual_v)))

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        center, u, v, _ = self._host
        middle, reach = center.dot(direction), math.hypot(u.dot(direction), v.dot(direction))
        return float(middle - reach), float(middle + reach)

    # ---- in kernels ----------------------------------------------------------------

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        o_n, _, inv_n = ray.onto(self._axes[0].axis)
        t = (self.plane_offset - o_n) * inv_n
        return Hit(self._covers(ray, t) & (t > 0) & (t < maxt), t, UInt32(numbers[0]))

    def _covers(self, ray: ProjectedRay, t: Float) -> Bool:
        """Whether the point at `t`, which is on the disk's plane, is on the disk."""
        if self._round:
            # Along a coordinate axis the component is 0; otherwise three components are cheaper than two projections.
            skipped = self._axes[0].axis.coordinate
            local = [dr.fma(ray.ray.d[k], t, ray.ray.o[k] - self.center[k]) for k in range(3) if k != skipped]
            return dr.squared_norm(Point2f(*local) if len(local) == 2 else Vector3f(*local)) <= self.radius_squared
        o_u, d_u, _ = ray.onto(self._axes[1].axis)
        o_v, d_v, _ = ray.onto(self._axes[2].axis)
        x = dr.fma(d_u, t, o_u - self.center_u) * self.scale_u
        y = dr.fma(d_v, t, o_v - self.center_v) * self.scale_v
        return dr.fma(x, x, dr.square(y)) <= 1

    def normal_at(self, p: Point3f) -> Vector3f:
        return Vector3f(self.normal)

    def tangent_at(self, p: Point3f) -> Vector3f:
        x, y, _ = self._polar(p)
        return dr.normalize(self.edge_u * x + self.edge_v * y)

    def _polar(self, p: Point3f) -> tuple[Float, Float, Float]:
        """The local polar coordinates of a point: cos(phi), sin(phi) and r."""
        x, y = self.local(p)
        r_squared = dr.fma(x, x, dr.square(y))
        inv_r = dr.rsqrt(r_squared)
        there = r_squared > 0
        return dr.select(there, x * inv_r, 1), dr.select(there, y * inv_r, 0), dr.select(there, r_squared * inv_r, 0)

    def draw_point(self, sample: Point2f) -> PositionSample3f:
        local = square_to_uniform_disk_concentric(sample)
        p = dr.fma(self.edge_u, local.x, dr.fma(self.edge_v, local.y, self.center))
        return PositionSample3f.of(p, self.normal, polar_uv(local.x, local.y, dr.norm(local)), dr.rcp(self.area))

    def at_uv(self, uv: Point2f) -> PositionSample3f:
        sin, cos = dr.sincos(2 * math.pi * uv.y)
        p = dr.fma(self.edge_u, uv.x * cos, dr.fma(self.edge_v, uv.x * sin, self.center))
        stretch = 2 * uv.x * self.area
        return PositionSample3f.of(p, self.normal, uv, dr.select(stretch > 0, dr.rcp(stretch), 0))

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        cos, sin, r = self._polar(p)
        du = self.edge_u * cos + self.edge_v * sin
        dv = (2 * math.pi * r) * (self.edge_v * cos - self.edge_u * sin)
        return polar_uv(cos, sin, r), du, dv

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.disk import DiskSilhouette

        return DiskSilhouette


def polar_uv(x: Float, y: Float, r: Float) -> Point2f:
    """The texture coordinates (r, phi / 2 pi), with phi in [0, 2 pi)."""
    phi = dr.atan2(y, x) * (1 / (2 * math.pi))
    return Point2f(r, dr.select(phi < 0, phi + 1, phi))


register_shape("disk", Disk)
