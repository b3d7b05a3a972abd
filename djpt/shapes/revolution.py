"""The base of surfaces of revolution: an axis, and the angle around it."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.description.properties import Properties
from djpt.jit.kernels import as_float, as_vector
from djpt.jit.types import Bool, Float, Point2f, Point3f, Vector3f
from djpt.shapes.axes import AxisPool, ProjectedRay
from djpt.shapes.base import Shape

__all__ = ["Revolution", "along"]


class Revolution(Shape):
    """A surface of revolution about the local z axis; `center` is a point of the axis.

    `to_world` maps the unit shape about +z to the world; subclasses declare the attributes below as `values`.
    """

    origin: ClassVar[float] = 0.0
    """The place of `center` on the axis, from 0 at its start to 1 at its end."""

    center: Vector3f
    axis_x: Vector3f
    axis_y: Vector3f
    axis_z: Vector3f
    length: Float
    """The length of the axis."""
    side: Float
    """The sign of normals: -1 with `flip_normals`."""

    def stretch_along(
        self, props: Properties, start: NDArray[np.float64], axis: NDArray[np.float64], length: float, radius: float
    ) -> None:
        """Let the shape start at a point, and reach a length and a radius along `axis`; that must not be zero."""
        if not axis.any():
            raise props.error("axis", "has length 0")
        self.stretch(along(start, axis * (length / float(np.linalg.norm(axis))), radius), props.node)

    def misfit(self, matrix: NDArray[np.float64]) -> str | None:
        lengths = np.linalg.norm(matrix[:3, :3], axis=0)
        unit = matrix[:3, :3] / lengths
        if np.abs(unit.T @ unit - np.eye(3)).max() > 1e-4 or abs(lengths[0] / lengths[1] - 1) > 1e-4:
            name = type(self).__name__.lower()
            return f"the 'to_world' of a {name} may only scale uniformly, rotate, mirror and translate"
        return None

    # ---- on the host ---------------------------------------------------------------

    def place(self, pool: AxisPool) -> None:
        matrix = self.to_world.matrix
        lengths = np.linalg.norm(matrix[:3, :3], axis=0)
        directions, start, edge = (matrix[:3, :3] / lengths).T, matrix[:3, 3], matrix[:3, 2]
        radius, length = float(lengths[0]), float(lengths[2])
        self._axes = pool.find(directions[2:], self._axes)
        self._host = (start, edge, radius, length)
        center = start + self.origin * edge if self.origin else start
        self.center = as_vector(center)
        self.axis_x, self.axis_y, self.axis_z = (as_vector(d) for d in directions)
        self.length, self.side = as_float(length), as_float(-1.0 if self.flip_normals else 1.0)
        # Measured along the pool's axis, which may point the other way.
        self.center_place = as_float(float(center.dot(self._axes[0].axis.direction)))
        self.measure(radius, length)

    def measure(self, radius: float, length: float) -> None:
        """Compute the values of the subclass, for a radius across the axis and a length along it."""
        raise NotImplementedError

    def ends(self, direction: NDArray[np.float64]) -> tuple[float, float, float]:
        """The coordinates of the axis' ends along a direction, and how far a circle of the radius reaches beyond."""
        start, edge, radius, _ = self._host
        across = direction - edge * (edge.dot(direction) / edge.dot(edge))
        return start.dot(direction), (start + edge).dot(direction), radius * float(np.linalg.norm(across))

    # ---- in kernels ----------------------------------------------------------------

    def split(self, ray: ProjectedRay) -> tuple[Any, Any, Float, Float]:
        """Split a ray into parts across and along the axis, relative to `center`.

        Returns origin across, direction across, origin along, direction along.
        """
        axis = self._axes[0].axis
        o_z, d_z, _ = ray.onto(axis)
        o_z = o_z - self.center_place
        if axis.coordinate is None:
            o = dr.fma(axis.vector, -o_z, ray.ray.o - self.center)
            return o, dr.fma(axis.vector, -d_z, ray.ray.d), o_z, d_z
        # Along a coordinate axis, the component across is 0 and is left out.
        across = [k for k in range(3) if k != axis.coordinate]
        flat = Point2f(*(ray.ray.o[k] - self.center[k] for k in across))
        return flat, Point2f(*(ray.ray.d[k] for k in across)), o_z, d_z

    def first_root(
        self, a: Float, b: Float, c: Float, root: Float, shift: Float, o_z: Float, d_z: Float
    ) -> tuple[Float, Bool]:
        """The first zero t > 0 of a (t - shift)^2 + 2 b (t - shift) + c that is `_within`, and whether it is.

        `root` is that of the discriminant. Of the two zeros, the one without cancellation gives the other: their
        product is known.
        """
        sum_ = -(b + dr.mulsign(root, b))
        t1, t2 = sum_ * dr.rcp(a) + shift, c * dr.rcp(sum_) + shift
        near, far = dr.select(t1 < t2, t1, t2), dr.select(t1 < t2, t2, t1)
        on_near = (near > 0) & self._within(dr.fma(d_z, near, o_z))
        t = dr.select(on_near, near, far)
        return t, self._within(dr.fma(d_z, t, o_z))

    def _within(self, z: Float) -> Bool:
        """Whether a place along the axis, as `split` measures it, is that of the surface."""
        raise NotImplementedError

    def across(self, p: Point3f) -> tuple[Vector3f, Float]:
        """The vector from the axis to a point, perpendicular to it, and the point's place along it from `center`."""
        local = p - self.center
        z = dr.dot(local, self.axis_z)
        return dr.fma(self.axis_z, -z, local), z

    def around(self, across: Vector3f) -> Vector3f:
        """The derivative of the position by phi, for a point at `across` from the axis."""
        return self.axis_y * dr.dot(across, self.axis_x) - self.axis_x * dr.dot(across, self.axis_y)

    def outward(self, across: Vector3f) -> Vector3f:
        """The unit vector away from the axis, for a point at `across` from it; `axis_x` on the axis."""
        squared = dr.squared_norm(across)
        return dr.select(squared > 0, across * dr.rsqrt(squared), self.axis_x)

    def turn(self, across: Vector3f) -> Float:
        """The angle around the axis as phi / 2 pi, from 0 to 1."""
        x, y = dr.dot(across, self.axis_x), dr.dot(across, self.axis_y)
        phi = dr.atan2(y, x) * (1 / (2 * math.pi))
        return dr.select(phi < 0, phi + 1, phi)

    def radial(self, u: Float) -> Vector3f:
        """The unit vector away from the axis where phi / 2 pi is `u`."""
        sin, cos = dr.sincos(2 * math.pi * u)
        return dr.fma(self.axis_x, cos, self.axis_y * sin)

    def tangent_at(self, p: Point3f) -> Vector3f:
        across, _ = self.across(p)
        around = self.around(across)
        length = dr.squared_norm(around)
        return dr.select(length > 0, around * dr.rsqrt(length), self.axis_y)


def along(start: NDArray[np.float64], extent: NDArray[np.float64], radius: float) -> ScalarTransform4f:
    """The affine map that takes the segment (0, 0, 0) (0, 0, 1) to `start` and `start + extent`.

    It scales by `radius` across the segment. x and y are Mitsuba's choice: Duff's frame, see `djpt.core.frame`, in
    double precision.
    """
    z = extent / np.linalg.norm(extent)
    sign = math.copysign(1.0, z[2])
    a = -1 / (sign + z[2])
    b = z[0] * z[1] * a
    matrix = np.eye(4)
    matrix[:3, 0] = radius * np.array([1 + sign * z[0] ** 2 * a, sign * b, -sign * z[0]])
    matrix[:3, 1] = radius * np.array([b, sign + z[1] ** 2 * a, -z[1]])
    matrix[:3, 2], matrix[:3, 3] = extent, start
    return ScalarTransform4f(matrix)
