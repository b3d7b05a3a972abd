"""The sphere, which may be much larger than what stands on it.

Coordinates relative to the centre of a sphere of radius R have errors of R 2^-24, which may be more than a ray's offset
from the surface. But the surface may pass near the origin, where coordinates are small. So a large sphere is written as

    Q(p) = |p|^2 - 2 p.c + k = 0,    k = |c|^2 - R^2    from double precision,

whose value at a point at height h is 2 R h, with an error of about R |p| 2^-22: that of h is one of |p|, not of R.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f
from djpt.core.records import RAY_EPSILON, DirectionSample3f, PositionSample3f, Ray3f
from djpt.core.transforms import ScalarTransform4f
from djpt.core.warp import square_to_uniform_sphere
from djpt.description.plugin import HIDDEN
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.jit.kernels import as_float, as_vector, maximum
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.axes import AxisPool, ProjectedRay
from djpt.shapes.base import Hit, Shape
from djpt.shapes.mitsuba_api import ShapeType

if TYPE_CHECKING:
    from djpt.description.plugin import Frame
    from djpt.shapes.silhouettes.base import Silhouette

__all__ = ["Sphere", "intersect_large", "is_large"]

ROUNDING = 2.0**-21
"""The error of a hit that is computed relative to the centre, per unit of the coordinates."""


def is_large(distance: float, radius: float) -> bool:
    """Whether hits computed relative to the centre, at a `distance` from the origin, are too rough near the origin.

    That is so if their error may exceed a spawned ray's offset where the surface is nearest to the origin.
    """
    return ROUNDING * (distance + radius) > RAY_EPSILON * (1 + abs(distance - radius))


def intersect_large(ray: Ray3f, center: Point3f, radius: Float, power: Float) -> tuple[Bool, Float]:
    """Whether a ray hits a sphere at some t > 0, and the first such t; `power` is k, that of the origin."""
    d = ray.d
    inv = dr.rcp(dr.squared_norm(d))
    # Rays from far away begin at two radii from the point closest to the centre.
    closest = (dr.dot(center, d) - dr.dot(ray.o, d)) * inv
    start = dr.maximum(closest - 2 * radius * dr.sqrt(inv), 0)
    o = dr.fma(d, start, ray.o)
    slope = dr.dot(o, d) - dr.dot(center, d)
    value = dr.dot(o, o - 2 * center) + power
    discriminant = dr.fma(slope, slope, -dr.squared_norm(d) * value)
    # One solution is a sum of equal signs, the other their product divided by it: nothing cancels.
    both = -(slope + dr.mulsign(dr.sqrt(discriminant), slope))
    first, second = value * dr.rcp(both), both * inv
    near, far = dr.minimum(first, second), dr.maximum(first, second)
    t = start + dr.select(near > 0, near, far)
    return (discriminant >= 0) & (t > start) & (t < math.inf), t


class Sphere(Shape):
    """All points at distance `radius` from `center`, mapped by `to_world`.

    Parameters: `center` (default origin), `radius` (default 1), `to_world` (rotation,
    translation and uniform scale; default identity), `flip_normals` (default false).
    uv = (phi / 2 pi, theta / pi) in local spherical coordinates about +z.
    """

    shape_kind = ShapeType.Sphere
    closed = True
    has_parameterization = True
    canonical = "sphere"
    values = dict.fromkeys(("center", "radius", "area", "axis_x", "axis_y", "axis_z"), HIDDEN)
    statics = ("flip_normals",)
    large = False
    """Whether the sphere is much larger than its distance from the origin: see `djpt.shapes.sphere`."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        local = ScalarTransform4f().translate(props.vector("center", (0, 0, 0)))
        self.stretch(local.scale(props.float("radius", 1.0, low=0.0, low_open=True)), props.node)

    def misfit(self, matrix: NDArray[np.float64]) -> str | None:
        lengths = np.linalg.norm(matrix[:3, :3], axis=0)
        gram = matrix[:3, :3].T @ matrix[:3, :3]
        if (
            np.abs(gram - np.diag(lengths**2)).max() > 1e-4 * lengths.max() ** 2
            or np.ptp(lengths) > 1e-4 * lengths.max()
        ):
            return "the 'to_world' of a sphere may only scale uniformly, rotate and translate"
        return None

    def move_into(self, frame: Frame) -> None:
        super().move_into(frame)
        self.__dict__.pop("large", None)

    def place(self, pool: AxisPool) -> None:
        matrix = self.to_world.matrix
        radius = float(np.linalg.norm(matrix[:3, 0]))
        self._host = (matrix[:3, 3], radius)
        self.center, self.radius = as_vector(matrix[:3, 3]), as_float(radius)
        self.area = as_float(4 * math.pi * radius**2)
        distance = float(np.linalg.norm(matrix[:3, 3]))
        # Once large, always large: so an edit back and forth compiles one kernel at most.
        self.large = self.large or is_large(distance, radius)
        self.power = as_float(float(matrix[:3, 3] @ matrix[:3, 3]) - radius**2)
        self.axis_x, self.axis_y, self.axis_z = (as_vector(matrix[:3, k] / radius) for k in range(3))

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        center, radius = self._host
        middle = center.dot(direction)
        return float(middle - radius), float(middle + radius)

    # ---- in kernels ----------------------------------------------------------------

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        if self.large:
            met, distance = intersect_large(ray.ray, self.center, self.radius, self.power)
            return Hit(met & (distance < maxt), distance, UInt32(numbers[0]))
        # The quadratic is solved from the point of the ray closest to the centre: the
        # discriminant then doesn't cancel for spheres that are small or far away.
        # E. Haines et al., "Precision Improvements for Ray/Sphere Intersection", Ray Tracing Gems, ch. 7, 2019.
        o, d = ray.ray.o - self.center, ray.ray.d
        inv_length_squared = dr.rcp(dr.squared_norm(d))
        middle = -dr.dot(o, d) * inv_length_squared
        closest = dr.fma(d, middle, o)
        reach = dr.sqrt((dr.square(self.radius) - dr.squared_norm(closest)) * inv_length_squared)
        # As whole numbers, less one, the bits of floats that aren't hits exceed those of any maxt: 0, negative ones,
        # and the NaN of rays that pass by. So one comparison is enough. (The distance loses its last bit.) A negative
        # maxt would exceed them, too.
        near, far = (UInt32(dr.reinterpret_array(UInt32, t)) - 1 for t in (middle - reach, middle + reach))
        t = UInt32(dr.minimum(near, far))
        hit = t < UInt32(dr.reinterpret_array(UInt32, maximum(maxt, 0)))
        return Hit(hit, Float(dr.reinterpret_array(Float, t)), UInt32(numbers[0]))

    def occludes(self, ray: ProjectedRay, numbers: Sequence[int]) -> Bool:
        if self.large or not ray.unbounded:
            return super().occludes(ray, numbers)
        # A ray without an end meets the surface if it enters the ball: no square root is needed.
        o, d = ray.ray.o - self.center, ray.ray.d
        middle = -dr.dot(o, d) * dr.rcp(dr.squared_norm(d))
        closest = dr.fma(d, dr.select(middle > 0, middle, 0), o)
        return dr.squared_norm(closest) < dr.square(self.radius)

    def normal_at(self, p: Point3f) -> Vector3f:
        n = dr.normalize(p - self.center)
        return -n if self.flip_normals else n

    def tangent_at(self, p: Point3f) -> Vector3f:
        # At the poles dp/du is 0, and any tangent will do.
        local = p - self.center
        s = self.axis_y * dr.dot(self.axis_x, local) - self.axis_x * dr.dot(self.axis_y, local)
        length = dr.squared_norm(s)
        return dr.select(length > 0, s * dr.rsqrt(length), self.axis_x)

    def draw_point(self, sample: Point2f) -> PositionSample3f:
        local = square_to_uniform_sphere(sample)
        d = self.axis_x * local.x + self.axis_y * local.y + self.axis_z * local.z
        p = dr.fma(d, self.radius, self.center)
        return PositionSample3f.of(p, -d if self.flip_normals else d, self._uv(local), dr.rcp(self.area))

    def at_uv(self, uv: Point2f) -> PositionSample3f:
        sin_phi, cos_phi = dr.sincos(2 * math.pi * uv.x)
        sin, cos = dr.sincos(math.pi * uv.y)
        d = self.axis_x * (sin * cos_phi) + self.axis_y * (sin * sin_phi) + self.axis_z * cos
        stretch = (0.5 * math.pi) * sin * self.area
        pdf = dr.select(stretch > 0, dr.rcp(stretch), 0)
        return PositionSample3f.of(dr.fma(d, self.radius, self.center), -d if self.flip_normals else d, uv, pdf)

    def draw_direction(self, ref: Point3f, sample: Point2f) -> DirectionSample3f:
        """Sample uniformly in the cone that the sphere subtends, or, from inside, uniformly by area.

        The cone is sampled by points on the visible cap, without intersecting a ray:
        "Sampling the visible sphere", A. Kalin (akalin.com/sampling-visible-sphere).
        """
        to_center = self.center - ref
        dist_squared = dr.squared_norm(to_center)
        outside = dist_squared > dr.square(self.radius * self._shrunk())

        inv_dist = dr.rsqrt(dist_squared)
        sin_max = self.radius * inv_dist
        sin_max_squared = dr.square(sin_max)
        cos_max = dr.safe_sqrt(1 - sin_max_squared)
        # Below 1.5 degrees 1 - cos cancels: use the first term of its series.
        sin_squared = dr.select(
            sin_max_squared > 0.00068523,
            1 - dr.square(dr.fma(cos_max - 1, sample.x, 1)),
            sin_max_squared * sample.x,
        )
        cos = dr.safe_sqrt(1 - sin_squared)
        inv_sin_max = dr.rcp(sin_max)
        cos_alpha = sin_squared * inv_sin_max + cos * dr.safe_sqrt(1 - sin_squared * dr.square(inv_sin_max))
        sin_alpha = dr.safe_sqrt(1 - dr.square(cos_alpha))
        sin_phi, cos_phi = dr.sincos(2 * math.pi * sample.y)
        towards = Frame3f.from_normal(to_center * -inv_dist)
        cap = towards.to_world(Vector3f(cos_phi * sin_alpha, sin_phi * sin_alpha, cos_alpha))
        # 1 - cos without cancellation: sin^2 / (1 + cos).
        solid_angle = 2 * math.pi * sin_max_squared * dr.rcp(1 + cos_max)

        n = dr.select(outside, cap, square_to_uniform_sphere(sample))
        p = dr.fma(n, self.radius, self.center)
        to_p = p - ref
        dist = dr.norm(to_p)
        # From a point of the sphere itself all of the cap is this point.
        d = dr.select(dist > 0, to_p * dr.rcp(dist), to_center * inv_dist)
        from_area = dr.abs(dr.dot(d, n)) * self.area * dr.rcp(dr.square(dist))
        weight = dr.select(outside, solid_angle, from_area)
        ok = (dist > 0) & (weight > 0)
        return DirectionSample3f.of(
            p,
            -n if self.flip_normals else n,
            self._uv(self._to_local(n)),
            d,
            dist,
            dr.select(ok, dr.rcp(weight), 0),
            dr.select(ok, weight, 0),
            Bool(False),
            UInt32(0),
        )

    def direction_density(self, ref: Point3f, ds: DirectionSample3f) -> Float:
        dist_squared = dr.squared_norm(self.center - ref)
        sin_squared = dr.square(self.radius) * dr.rcp(dist_squared)
        cos = dr.safe_sqrt(1 - sin_squared)
        outside = dist_squared > dr.square(self.radius * self._shrunk())
        in_cone = dr.rcp(2 * math.pi * sin_squared * dr.rcp(1 + cos))
        in_area = dr.square(ds.dist) * dr.rcp(dr.abs(dr.dot(ds.d, ds.n)) * self.area)
        return dr.select(outside, in_cone, dr.select(dr.isfinite(in_area), in_area, 0))

    def _shrunk(self) -> float:
        # A point that was moved off the surface must count as outside, or with `flip_normals` as inside.
        return 1 + RAY_EPSILON if self.flip_normals else 1 - RAY_EPSILON

    def _to_local(self, d: Vector3f) -> Vector3f:
        return Vector3f(dr.dot(self.axis_x, d), dr.dot(self.axis_y, d), dr.dot(self.axis_z, d))

    def _uv(self, local: Vector3f) -> Point2f:
        phi = dr.atan2(local.y, local.x)
        u = dr.select(phi < 0, phi + 2 * math.pi, phi) * (1 / (2 * math.pi))
        return Point2f(u, dr.safe_acos(local.z) * (1 / math.pi))

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        local = self._to_local(p - self.center)
        unit = local * dr.rcp(self.radius)
        rim = dr.sqrt(dr.square(local.x) + dr.square(local.y))
        inv_rim = dr.select(rim > 0, dr.rcp(rim), 0)
        cos_phi, sin_phi = dr.select(rim > 0, local.x * inv_rim, 1), local.y * inv_rim
        du = 2 * math.pi * (self.axis_y * local.x - self.axis_x * local.y)
        dv = math.pi * (self.axis_x * (local.z * cos_phi) + self.axis_y * (local.z * sin_phi) - self.axis_z * rim)
        return self._uv(unit), du, dv

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.sphere import SphereSilhouette

        return SphereSilhouette


register_shape("sphere", Sphere)
