"""The open cylinder."""

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
from djpt.errors import SceneError
from djpt.jit.kernels import as_float
from djpt.jit.types import Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.axes import ProjectedRay
from djpt.shapes.base import Hit
from djpt.shapes.mitsuba_api import ShapeType
from djpt.shapes.revolution import Revolution, along

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.base import Silhouette

__all__ = ["Cylinder"]


class Cylinder(Revolution):
    """All points at distance `radius` from the segment `p0` `p1`, between its ends; without caps.

    Parameters: `p0` (default origin), `p1` (default (0, 0, 1)), `radius` (default 1), `to_world` (rotation,
    translation, uniform scale, reflection; default identity), `flip_normals` (default false).
    uv = (phi / 2 pi, z) with z from 0 at `p0` to 1 at `p1`; phi counts from the x axis of the frame that
    `djpt.core.frame.coordinate_system` gives for p1 - p0. Normals point outwards unless `flip_normals` is set,
    also those of sampled points: Mitsuba 3.9.1 samples a reflected cylinder with normals that point inwards.
    """

    in_any_frame = True
    shape_kind = ShapeType.Cylinder
    has_parameterization = True
    canonical = "cylinder"
    origin = 0.5  # halfway along the axis rounding errors are smallest
    values = dict.fromkeys(("center", "axis_x", "axis_y", "axis_z", "radius", "length", "side", "area"), HIDDEN)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        p0, p1 = props.vector("p0", (0, 0, 0)), props.vector("p1", (0, 0, 1))
        radius = props.float("radius", 1.0, low=0.0, low_open=True)
        if not (p1 - p0).any():
            raise SceneError(f"{props.node}: 'p0' and 'p1' are the same point {p0.tolist()}")
        self.stretch(along(p0, p1 - p0, radius), props.node)

    # ---- on the host ---------------------------------------------------------------

    def measure(self, radius: float, length: float) -> None:
        self.radius, self.area = as_float(radius), as_float(2 * math.pi * radius * length)
        self.radius_squared, self.half_length = as_float(radius**2), as_float(0.5 * length)

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        start, end, reach = self.ends(direction)
        return float(min(start, end)) - reach, float(max(start, end)) + reach

    # ---- in kernels ----------------------------------------------------------------

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        # As for the sphere, from the point closest to the axis: the discriminant then doesn't cancel.
        o, d, o_z, d_z = self.split(ray)
        inv_length_squared = dr.rcp(dr.squared_norm(d))
        middle = -dr.dot(o, d) * inv_length_squared
        closest = dr.fma(d, middle, o)
        # NaN for rays along the axis, so that no comparison is true for them.
        discriminant = (self.radius_squared - dr.squared_norm(closest)) * inv_length_squared
        reach = dr.sqrt(dr.select(discriminant > 0, discriminant, 0))
        near, far = middle - reach, middle + reach
        on_near = (near > 0) & (dr.abs(dr.fma(d_z, near, o_z)) <= self.half_length)
        t = dr.select(on_near, near, far)
        inside = dr.abs(dr.fma(d_z, t, o_z)) <= self.half_length
        return Hit((discriminant >= 0) & inside & (t > 0) & (t < maxt), t, UInt32(numbers[0]))

    def normal_at(self, p: Point3f) -> Vector3f:
        across, _ = self.across(p)
        return across * (self.side * dr.rsqrt(dr.squared_norm(across)))

    def draw_point(self, sample: Point2f) -> PositionSample3f:
        n = self.radial(sample.y)
        p = dr.fma(n, self.radius, dr.fma(self.axis_z, (sample.x - 0.5) * self.length, self.center))
        return PositionSample3f.of(p, n * self.side, Point2f(sample.y, sample.x), dr.rcp(self.area))

    def at_uv(self, uv: Point2f) -> PositionSample3f:
        return self.draw_point(Point2f(uv.y, uv.x))

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        across, z = self.across(p)
        uv = Point2f(self.turn(across), dr.fma(z, dr.rcp(self.length), 0.5))
        return uv, 2 * math.pi * self.around(across), self.axis_z * self.length

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.cylinder import CylinderSilhouette

        return CylinderSilhouette


register_shape("cylinder", Cylinder)
