"""The open paraboloid of revolution."""

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

__all__ = ["Paraboloid"]


class Paraboloid(Revolution):
    """All points at the distance r from an axis and r^2 / (4 f) along it from the `vertex`, as far as `length`.

    f is the focal length: mirrors of this form make light of the focus, at the distance f from the vertex, parallel.

    Parameters: `vertex` (default (0, 0, 0)), `axis` (from the vertex to the opening, any length; default (0, 0, 1)),
    `focal_length` (default 0.25), `length` (of the axis, default 1), `to_world` (rotation, translation, uniform scale,
    reflection; default identity), `flip_normals` (default false). uv = (phi / 2 pi, r / r of the rim), phi as for the
    cylinder. Normals point outwards, away from the axis.
    """

    in_any_frame = True
    has_parameterization = True
    values = dict.fromkeys(
        ("center", "axis_x", "axis_y", "axis_z", "focal_length", "length", "radius", "growth", "side", "area"), HIDDEN
    )

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        vertex, axis = props.vector("vertex", (0, 0, 0)), props.vector("axis", (0, 0, 1))
        focal_length = props.float("focal_length", 0.25, low=0.0, low_open=True)
        length = props.float("length", 1.0, low=0.0, low_open=True)
        self.stretch_along(props, vertex, axis, length, math.sqrt(4 * focal_length * length))

    # ---- on the host ---------------------------------------------------------------

    def measure(self, radius: float, length: float) -> None:
        focal_length = radius**2 / (4 * length)
        self.focal_length, self.radius = as_float(focal_length), as_float(radius)
        # The area up to r is 8 pi f^2 / 3 ((1 + r^2 / 4 f^2)^(3/2) - 1).
        growth = (1 + length / focal_length) ** 1.5 - 1
        self.growth, self.area = as_float(growth), as_float(8 * math.pi * focal_length**2 / 3 * growth)
        self.along_axis = as_float(-1.0 if self._axes[0].negative else 1.0)

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        vertex, edge, radius, length = self._host
        along_axis = float(direction.dot(edge / length))
        across = math.sqrt(max(0.0, float(direction.dot(direction)) - along_axis**2))
        # At the fraction s of the rim's radius, the extent is s^2 length along the axis, and s radius across it.
        slope, bend = across * radius, along_axis * length
        shares = [0.0, 1.0]
        if bend:
            shares += [min(max(s, 0.0), 1.0) for s in (slope / (2 * bend), -slope / (2 * bend))]
        ends = [bend * s * s + sign * slope * s for s in shares for sign in (-1, 1)]
        start = float(vertex.dot(direction))
        return start + min(ends), start + max(ends)

    # ---- in kernels ----------------------------------------------------------------

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        """Solve |p|^2 = 4 f z, p across the axis, from the point of the ray closest to the vertex."""
        o, d, o_z, d_z = self.split(ray)
        o_z, d_z = o_z * self.along_axis, d_z * self.along_axis
        shift = -dr.fma(o_z, d_z, dr.dot(o, d)) * dr.rcp(dr.fma(d_z, d_z, dr.squared_norm(d)))
        q, z = dr.fma(d, shift, o), dr.fma(d_z, shift, o_z)
        a, c = dr.squared_norm(d), dr.fma(-4 * self.focal_length, z, dr.squared_norm(q))
        b = dr.fma(-2 * self.focal_length, d_z, dr.dot(q, d))
        discriminant = dr.fma(b, b, -a * c)
        root = dr.sqrt(dr.select(discriminant > 0, discriminant, 0))
        # A ray along the axis has one hit: the other is at infinity, which isn't on the surface.
        t, inside = self.first_root(a, b, c, root, shift, o_z, d_z)
        return Hit((discriminant >= 0) & inside & (t > 0) & (t < maxt), t, UInt32(numbers[0]))

    def _within(self, z: Float) -> Bool:
        """Whether a place along the axis isn't beyond the rim; places before the vertex are never hit."""
        return z <= self.length

    def normal_at(self, p: Point3f) -> Vector3f:
        return self._normal(self.across(p)[0])

    def _normal(self, across: Vector3f) -> Vector3f:
        """The normal at `across` from the axis."""
        return dr.normalize(dr.fma(self.axis_z, -2 * self.focal_length, across)) * self.side

    def draw_point(self, sample: Point2f) -> PositionSample3f:
        grown = dr.fma(sample.x, self.growth, 1)
        stretched = dr.cbrt(dr.square(grown))
        r = 2 * self.focal_length * dr.safe_sqrt(stretched - 1)
        return self._at(sample.y, r)

    def at_uv(self, uv: Point2f) -> PositionSample3f:
        ps = self._at(uv.x, uv.y * self.radius)
        r = uv.y * self.radius
        slant = dr.sqrt(1 + dr.square(r * dr.rcp(2 * self.focal_length)))
        stretch = 2 * math.pi * r * slant * self.radius
        return PositionSample3f.of(ps.p, ps.n, uv, dr.select(stretch > 0, dr.rcp(stretch), 0))

    def _at(self, turn: Float, r: Float) -> PositionSample3f:
        """The point at the distance `r` from the axis, as if drawn by area."""
        across = self.radial(turn) * r
        z = dr.square(r) * dr.rcp(4 * self.focal_length)
        p = dr.fma(self.axis_z, z, self.center) + across
        return PositionSample3f.of(p, self._normal(across), Point2f(turn, r * dr.rcp(self.radius)), dr.rcp(self.area))

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        across, _ = self.across(p)
        squared = dr.squared_norm(across)
        length = dr.sqrt(squared)
        dv = dr.fma(self.axis_z, length * dr.rcp(2 * self.focal_length), self.outward(across)) * self.radius
        return Point2f(self.turn(across), length * dr.rcp(self.radius)), 2 * math.pi * self.around(across), dv

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.paraboloid import ParaboloidSilhouette

        return ParaboloidSilhouette


register_shape("paraboloid", Paraboloid)
