"""The infinite plane."""

from __future__ import annotations

import math
from collections.abc import Sequence

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f
from djpt.core.records import DirectionSample3f
from djpt.core.warp import square_to_uniform_cone
from djpt.description.plugin import HIDDEN
from djpt.description.registry import register_shape
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.axes import ALIGNED, AxisPool, ProjectedRay
from djpt.shapes.base import Face, Hit
from djpt.shapes.flat import FlatShape

__all__ = ["Plane"]


class Plane(FlatShape):
    """All points with local z = 0, without a border; uv are the local x and y.

    Parameters: `to_world` (affine, default identity), `flip_normals` (default false). The front, where light is
    emitted, is the side of the transformed +z axis. As a light it is sampled uniformly over the hemisphere of
    directions that hit it, with the density 1 / (2 pi); its area is infinite.
    """

    in_any_frame = True
    has_area = False
    values = dict.fromkeys(("center", "edge_u", "edge_v", "normal", "dual_u", "dual_v"), HIDDEN)

    def place(self, pool: AxisPool) -> None:
        outward = self.lay()[1]
        center, u, _, _ = self._host
        self._axes = pool.find((outward, u), self._axes)
        self.plane_offset = as_float(float(center.dot(self._axes[0].axis.direction)))

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        center, _, _, normal = self._host
        unit = direction / np.linalg.norm(direction)
        if min(np.abs(unit - normal).max(), np.abs(unit + normal).max()) > ALIGNED:
            return -math.inf, math.inf
        return float(center.dot(direction)), float(center.dot(direction))

    def faces(self) -> Sequence[Face]:
        return [self.flat_face(self._axes[1])]

    # ---- in kernels ----------------------------------------------------------------

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        o_n, _, inv_n = ray.onto(self._axes[0].axis)
        t = (self.plane_offset - o_n) * inv_n
        return Hit((t > 0) & (t < maxt), t, UInt32(numbers[0]))

    def draw_direction(self, ref: Point3f, sample: Point2f) -> DirectionSample3f:
        height = dr.dot(ref - self.center, self.normal)
        towards = self.normal * dr.select(height > 0, Float(-1), Float(1))
        local = square_to_uniform_cone(sample, Float(0))
        d = Frame3f.from_normal(towards).to_world(local)
        dist = dr.abs(height) * dr.rcp(local.z)
        p = dr.fma(d, dist, ref)
        ok = (dist > 0) & dr.isfinite(dist)
        pdf, weight = dr.select(ok, Float(0.5 / math.pi), 0), dr.select(ok, Float(2 * math.pi), 0)
        return DirectionSample3f.of(
            p, Vector3f(self.normal), self.local(p), d, dist, pdf, weight, Bool(False), UInt32(0)
        )

    def direction_density(self, ref: Point3f, ds: DirectionSample3f) -> Float:
        towards = dr.dot(ds.d, self.normal) * dr.dot(ref - self.center, self.normal) < 0
        return dr.select(towards, Float(0.5 / math.pi), 0)

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        return self.local(p), Vector3f(self.edge_u), Vector3f(self.edge_v)


register_shape("plane", Plane)
