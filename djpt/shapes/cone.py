"""The open cone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import PositionSample3f
from djpt.description.plugin import HIDDEN
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.axes import ProjectedRay
from djpt.shapes.base import Hit
from djpt.shapes.revolution import Revolution

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.base import Silhouette

__all__ = ["Cone"]


class Cone(Revolution):
    """All points whose direction from `apex` makes the angle `angle` with `axis`, as far as `length` along it; no base.

    Parameters: `apex` (default (0, 0, 1)), `axis` (from the apex into the cone, any length; default (0, 0, -1)),
    `angle` (between axis and surface, degrees, in (0, 90); default 45), `length` (of the axis, default 1), `to_world`
    (rotation, translation, uniform scale, reflection; default identity), `flip_normals` (default false).
    uv = (phi / 2 pi, z) with z from 0 at the apex to 1 at the rim, phi as for the cylinder. Normals point outwards.
    """

    in_any_frame = True
    has_parameterization = True
    values = dict.fromkeys(
        ("center", "axis_x", "axis_y", "axis_z", "slope", "cos", "sin", "length", "side", "area"), HIDDEN
    )

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        apex, axis = props.vector("apex", (0, 0, 1)), props.vector("axis", (0, 0, -1))
        angle = props.float("angle", 45.0, low=0.0, high=90.0, low_open=True, high_open=True)
        length = props.float("length", 1.0, low=0.0, low_open=True)
        self.stretch_along(props, apex, axis, length, length * math.tan(math.radians(angle)))

    # ---- on the host ---------------------------------------------------------------

    def measure(self, radius: float, length: float) -> None:
        slant = math.hypot(radius, length)
        self.slope, self.area = as_float(radius / length), as_float(math.pi * radius * slant)
        self.cos, self.sin = as_float(length / slant), as_float(radius / slant)
        self.half_length = as_float(0.5 * length)
        self.middle = as_float(-0.5 * length if self._axes[0].negative else 0.5 * length)
        self.cos_squared, self.sin_squared = as_float((length / slant) ** 2), as_float((radius / slant) ** 2)

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        tip, base, reach = self.ends(direction)
        return float(min(tip, base - reach)), float(max(tip, base + reach))

    # ---- in kernels ----------------------------------------------------------------

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        """Solve z^2 - cos^2 |p|^2 = 0 with p relative to the apex, from the point q of the ray closest to the apex.

        There q . d = 0, so with m = q x d the discriminant is cos^2 (sin^2 |m|^2 - m_z^2), which doesn't cancel far
        from the cone.
        """
        o, d, o_z, d_z = self.split(ray)
        length_squared = dr.fma(d_z, d_z, dr.squared_norm(d))
        shift = -dr.fma(o_z, d_z, dr.dot(o, d)) * dr.rcp(length_squared)
        q, z = dr.fma(d, shift, o), dr.fma(d_z, shift, o_z)
        q_squared = dr.squared_norm(q)
        distance_squared = dr.fma(z, z, q_squared)
        a = dr.fma(d_z, d_z, -self.cos_squared * length_squared)
        c = dr.fma(self.sin_squared, dr.square(z), -self.cos_squared * q_squared)
        b = z * d_z
        moment = self._moment_along(q, d)
        discriminant = dr.fma(self.sin_squared, distance_squared * length_squared, -dr.square(moment))
        root = self.cos * dr.sqrt(dr.select(discriminant > 0, discriminant, 0))
        t, inside = self.first_root(a, b, c, root, shift, o_z, d_z)
        return Hit((discriminant >= 0) & inside & (t > 0) & (t < maxt), t, UInt32(numbers[0]))

    def _moment_along(self, q: Vector3f | Point2f, d: Vector3f | Point2f) -> Float:
        """The component (q x d) . axis of the moment."""
        if len(q) == 2:
            return dr.fma(q[0], d[1], -q[1] * d[0])
        return dr.dot(dr.cross(Vector3f(*q), Vector3f(*d)), self._axes[0].axis.vector)

    def _within(self, z: Float) -> Bool:
        """Whether `z` along the pool's axis is on the cone: not on its mirror image, not beyond the rim."""
        return dr.abs(z - self.middle) <= self.half_length

    def normal_at(self, p: Point3f) -> Vector3f:
        return self._tilted(self.outward(self.across(p)[0]))

    def _tilted(self, outward: Vector3f) -> Vector3f:
        """The normal at points where `outward` is the unit vector away from the axis."""
        return (outward * self.cos - self.axis_z * self.sin) * self.side

    def draw_point(self, sample: Point2f) -> PositionSample3f:
        outward, v = self.radial(sample.y), dr.sqrt(sample.x)
        z = v * self.length
        p = dr.fma(outward, z * self.slope, dr.fma(self.axis_z, z, self.center))
        return PositionSample3f.of(p, self._tilted(outward), Point2f(sample.y, v), dr.rcp(self.area))

    def at_uv(self, uv: Point2f) -> PositionSample3f:
        ps = self.draw_point(Point2f(dr.square(uv.y), uv.x))
        stretch = 2 * uv.y * self.area
        return PositionSample3f.of(ps.p, ps.n, uv, dr.select(stretch > 0, dr.rcp(stretch), 0))

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        across, z = self.across(p)
        dv = (self.axis_z + self.outward(across) * self.slope) * self.length
        return Point2f(self.turn(across), z * dr.rcp(self.length)), 2 * math.pi * self.around(across), dv

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.cone import ConeSilhouette

        return ConeSilhouette


register_shape("cone", Cone)
