"""The open cylinder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.plugin import ParamFlags
from djpt.description.properties import Properties
from djpt.errors import ParameterError, SceneError
from djpt.geometry.axes import AxisPool, ProjectedRay, SignedAxis
from djpt.lookup import as_float, as_vector
from djpt.records import PositionSample3f
from djpt.shapes.base import Hit, Shape
from djpt.transforms import ScalarTransform4f
from djpt.types import Float, Point2f, Point3f, UInt32, Vector3f

__all__ = ["Cylinder", "along"]

HIDDEN = ParamFlags.NonDifferentiable


class Cylinder(Shape):
    """All points at distance `radius` from the segment `p0` `p1`, between its ends; without caps.

    Parameters: `p0` (default origin), `p1` (default (0, 0, 1)), `radius` (default 1), `to_world` (rotation,
    translation, uniform scale, reflection; default identity), `flip_normals` (default false).
    uv = (phi / 2 pi, z) with z from 0 at `p0` to 1 at `p1`; phi counts from the x axis of the frame that
    `djpt.frame.coordinate_system` gives for p1 - p0. Normals point outwards
    unless `flip_normals` is set, also those of sampled points: Mitsuba 3.9.1 samples a reflected cylinder with normals that point inwards.
    """

    values = dict.fromkeys(("center", "axis_x", "axis_y", "axis_z", "radius", "length", "side", "area"), HIDDEN)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        p0, p1 = props.vector("p0", (0, 0, 0)), props.vector("p1", (0, 0, 1))
        radius = props.float("radius", 1.0, low=0.0, low_open=True)
        if not (p1 - p0).any():
            raise SceneError(f"{props.node}: 'p0' and 'p1' are the same point {p0.tolist()}")
        self.to_world = self.to_world @ along(p0, p1, radius)
        problem = self._problem(self.to_world.matrix)
        if problem:
            raise SceneError(f"{props.node}: {problem}")
        self._axes: tuple[SignedAxis, ...] | None = None

    @staticmethod
    def _problem(matrix: NDArray[np.float64]) -> str | None:
        lengths = np.linalg.norm(matrix[:3, :3], axis=0)
        unit = matrix[:3, :3] / lengths
        if np.abs(unit.T @ unit - np.eye(3)).max() > 1e-4 or abs(lengths[0] / lengths[1] - 1) > 1e-4:
            return "the 'to_world' of a cylinder may scale uniformly, rotate, mirror and translate, nothing else"
        return None

    def check_parameter(self, name: str, value: object) -> object:
        value = super().check_parameter(name, value)
        if name == "to_world" and isinstance(value, ScalarTransform4f):
            problem = self._problem(value.matrix)
            if problem:
                raise ParameterError(f"{self.id}.to_world: {problem}")
        return value

    # ---- on the host ---------------------------------------------------------------

    def place(self, pool: AxisPool) -> None:
        matrix = self.to_world.matrix
        lengths = np.linalg.norm(matrix[:3, :3], axis=0)
        base, (x, y, z) = matrix[:3, 3], (matrix[:3, :3] / lengths).T
        radius, length = float(lengths[0]), float(lengths[2])
        self._axes = pool.find((z,), self._axes)
        self._host = (base, z * length, radius)

        # The origin of coordinates in kernels: halfway along the axis, where rounding hurts least.
        center = base + 0.5 * length * z
        self.center, self.radius, self.length = as_vector(center), as_float(radius), as_float(length)
        self.axis_x, self.axis_y, self.axis_z = as_vector(x), as_vector(y), as_vector(z)
        self.side = as_float(-1.0 if self.flip_normals else 1.0)
        self.area = as_float(2 * math.pi * radius * length)
        self.radius_squared, self.half_length = as_float(radius**2), as_float(0.5 * length)
        self.middle = as_float(float(center.dot(self._axes[0].axis.direction)))

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        base, edge, radius = self._host
        ends = base.dot(direction), (base + edge).dot(direction)
        across = direction - edge * (edge.dot(direction) / edge.dot(edge))
        reach = radius * float(np.linalg.norm(across))
        return float(min(ends) - reach), float(max(ends) + reach)

    # ---- in kernels ----------------------------------------------------------------

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        # As for the sphere, from the point closest to the axis: the discriminant then doesn't cancel.
        assert self._axes is not None
        axis = self._axes[0].axis
        o_z, d_z, _ = ray.onto(axis)
        o_z = o_z - self.middle
        o: Any
        d: Any
        if axis.coordinate is None:
            o = dr.fma(axis.vector, -o_z, ray.ray.o - self.center)
            d = dr.fma(axis.vector, -d_z, ray.ray.d)
        else:
            # The component along the axis is left out.
            across = [k for k in range(3) if k != axis.coordinate]
            o = Point2f(*(ray.ray.o[k] - self.center[k] for k in across))
            d = Point2f(*(ray.ray.d[k] for k in across))
        inv_length_squared = dr.rcp(dr.squared_norm(d))
        middle = -dr.dot(o, d) * inv_length_squared
        closest = dr.fma(d, middle, o)
        # Not a number for rays along the axis: no comparison holds then.
        discriminant = (self.radius_squared - dr.squared_norm(closest)) * inv_length_squared
        reach = dr.sqrt(dr.select(discriminant > 0, discriminant, 0))
        near, far = middle - reach, middle + reach
        on_near = (near > 0) & (dr.abs(dr.fma(d_z, near, o_z)) <= self.half_length)
        t = dr.select(on_near, near, far)
        inside = dr.abs(dr.fma(d_z, t, o_z)) <= self.half_length
        return Hit((discriminant >= 0) & inside & (t > 0) & (t < maxt), t, UInt32(numbers[0]))

    def _across(self, p: Point3f) -> tuple[Vector3f, Float]:
        """From the axis to a point, at a right angle; and how far along the axis from its middle."""
        local = p - self.center
        z = dr.dot(local, self.axis_z)
        return dr.fma(self.axis_z, -z, local), z

    def normal_at(self, p: Point3f) -> Vector3f:
        across, _ = self._across(p)
        return across * (self.side * dr.rsqrt(dr.squared_norm(across)))

    def tangent_at(self, p: Point3f) -> Vector3f:
        across, _ = self._across(p)
        return dr.normalize(self._around(dr.dot(across, self.axis_x), dr.dot(across, self.axis_y)))

    def _around(self, x: Float, y: Float) -> Vector3f:
        """d(p) / d(phi)."""
        return self.axis_y * x - self.axis_x * y

    def surface_area(self) -> Float:
        return self.area

    def sample_position(self, sample: Point2f) -> PositionSample3f:
        sin, cos = dr.sincos(2 * math.pi * sample.y)
        n = dr.fma(self.axis_x, cos, self.axis_y * sin)
        p = dr.fma(n, self.radius, dr.fma(self.axis_z, (sample.x - 0.5) * self.length, self.center))
        return PositionSample3f(p, n * self.side, Point2f(sample.y, sample.x), dr.rcp(self.area))

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        across, z = self._across(p)
        x, y = dr.dot(across, self.axis_x), dr.dot(across, self.axis_y)
        phi = dr.atan2(y, x) * (1 / (2 * math.pi))
        uv = Point2f(dr.select(phi < 0, phi + 1, phi), dr.fma(z, dr.rcp(self.length), 0.5))
        return uv, 2 * math.pi * self._around(x, y), self.axis_z * self.length


def along(start: NDArray[np.float64], end: NDArray[np.float64], radius: float) -> ScalarTransform4f:
    """The transform of the unit cylinder about +z to the one from `start` to `end`; Mitsuba's choice of x and y."""
    length = float(np.linalg.norm(end - start))
    z = (end - start) / length
    # Duff's frame, in double precision: see djpt.frame.
    sign = math.copysign(1.0, z[2])
    a = -1 / (sign + z[2])
    b = z[0] * z[1] * a
    matrix = np.eye(4)
    matrix[:3, 0] = radius * np.array([1 + sign * z[0] ** 2 * a, sign * b, -sign * z[0]])
    matrix[:3, 1] = radius * np.array([b, sign + z[1] ** 2 * a, -z[1]])
    matrix[:3, 2], matrix[:3, 3] = end - start, start
    return ScalarTransform4f(matrix)
