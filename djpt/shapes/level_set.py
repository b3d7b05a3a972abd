"""Surfaces given by a function: the base of implicit surfaces and distance grids, and the first zero along a ray."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import Frame3f, coordinate_system
from djpt.core.records import RAY_EPSILON, DirectionSample3f, Ray3f
from djpt.description.properties import Properties
from djpt.jit.kernels import as_float, as_vector, maximum, minimum, while_loop
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.shapes.axes import AxisPool, ProjectedRay
from djpt.shapes.base import Hit, Shape

__all__ = ["PLACE", "LevelSet", "Zero", "first_zero", "gradient"]

PLACE = ("center", "dual_x", "dual_y", "dual_z", "low", "high", "ball_center", "ball_radius", "inverse_slope", "least")
"""The values that `LevelSet.place` sets; subclasses list them in `values`."""


class LevelSet(Shape):
    """The points of a box where `field` is 0; negative inside. Local coordinates, mapped by `to_world` (affine).

    The surface ends at the box. As a light it is sampled by directions, uniformly in the cone about the box's
    bounding sphere (or in all directions from within it); light comes from the first hit along the direction.
    Directions that miss, or hit the surface from inside, bring none. The density is 1 / solid angle of the cone.
    """

    has_area = False
    closed = True
    box: tuple[NDArray[np.float64], NDArray[np.float64]]
    """The box that holds the surface, in local coordinates: its smallest and largest corner."""
    reach = np.inf
    """Radius of a sphere about the middle of the box that holds the surface, in local coordinates."""
    slope = 0.0
    """A bound of the length of the gradient of `field` in the box; 0 if none is known."""
    steps = 4096
    """The diagonal of the box divided by the shortest step. Chords shorter than a step may be missed, so that a
    curve of radius r may look flatter by step^2 / (8 r)."""

    center: Vector3f
    dual_x: Vector3f
    dual_y: Vector3f
    dual_z: Vector3f
    low: Vector3f
    high: Vector3f
    ball_center: Vector3f
    ball_radius: Float
    inverse_slope: Float
    least: Float

    def __init__(self, props: Properties) -> None:
        super().__init__(props)

    def field(self, p: Point3f) -> Float:
        """The function at a local point; it must be continuous, and differentiable near the surface."""
        raise NotImplementedError

    # ---- on the host ---------------------------------------------------------------

    def place(self, pool: AxisPool) -> None:
        matrix = self.to_world.matrix
        inverse = np.linalg.inv(matrix[:3, :3])
        low, high = self.box
        self.center = as_vector(matrix[:3, 3])
        self.dual_x, self.dual_y, self.dual_z = (as_vector(row) for row in inverse)
        self.low, self.high = as_vector(low), as_vector(high)
        corners = self._box_corners()
        middle = corners.mean(axis=0)
        self.ball_center = as_vector(middle)
        stretch = float(np.linalg.norm(matrix[:3, :3], 2))
        self.ball_radius = as_float(min(float(np.linalg.norm(corners - middle, axis=1).max()), self.reach * stretch))
        self.inverse_slope = as_float(1 / self.slope if self.slope > 0 else 0.0)
        self.least = as_float(float(np.linalg.norm(high - low)) / self.steps)

    def _box_corners(self) -> NDArray[np.float64]:
        low, high = self.box
        local = np.array([[(low, high)[(i >> k) & 1][k] for k in range(3)] for i in range(8)])
        return local @ self.to_world.matrix[:3, :3].T + self.to_world.matrix[:3, 3]

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        along = self._box_corners() @ direction
        return float(along.min()), float(along.max())

    # ---- in kernels ----------------------------------------------------------------

    def to_local(self, v: Vector3f) -> Vector3f:
        """Map a world vector to local coordinates."""
        return Vector3f(dr.dot(self.dual_x, v), dr.dot(self.dual_y, v), dr.dot(self.dual_z, v))

    def normal_to_world(self, v: Vector3f) -> Vector3f:
        """Map a local gradient to world space; its length is unspecified."""
        return self.dual_x * v.x + self.dual_y * v.y + self.dual_z * v.z

    def intersect(self, ray: ProjectedRay, maxt: Float, numbers: Sequence[int]) -> Hit:
        zero = self.search(ray.ray, maxt)
        return Hit(zero.found & (zero.t > 0) & (zero.t < maxt), zero.t, UInt32(numbers[0]))

    def search(self, ray: Ray3f, maxt: Float) -> Zero:
        """The first zero along a ray within the box."""
        o, d = self.to_local(ray.o - self.center), self.to_local(ray.d)
        inv = dr.rcp(d)
        start, end = Float(0), maxt
        for k in range(3):
            t_low, t_high = (self.low[k] - o[k]) * inv[k], (self.high[k] - o[k]) * inv[k]
            start, end = maximum(minimum(t_low, t_high), start), minimum(maximum(t_low, t_high), end)
        inv_length = dr.rsqrt(dr.squared_norm(d))

        def along(t: Float) -> Float:
            return self.field(Point3f(dr.fma(d, t, o)))

        # Lanes that have left the scene have rays without a finite origin, whose search would have no end.
        somewhere = dr.isfinite(o.x + o.y + o.z) & dr.isfinite(end) & (start < end)
        with dr.suspend_grad():
            return first_zero(along, start, end, self.inverse_slope * inv_length, self.least * inv_length, somewhere)

    def normal_at(self, p: Point3f) -> Vector3f:
        n = dr.normalize(self.normal_to_world(gradient(self.field, self.local_point(p))))
        return -n if self.flip_normals else n

    def tangent_at(self, p: Point3f) -> Vector3f:
        n, du = self.normal_at(p), self.partials(p)[0]
        s = du - n * dr.dot(n, du)
        length = dr.squared_norm(s)
        return dr.select(length > 0, s * dr.rsqrt(length), coordinate_system(n)[0])

    def local_point(self, p: Point3f) -> Point3f:
        """Map a world point to local coordinates."""
        return Point3f(self.to_local(p - self.center))

    def uv_and_partials(self, p: Point3f, face: UInt32) -> tuple[Point2f, Vector3f, Vector3f]:
        return self.uv(p), *self.partials(p)

    def uv(self, p: Point3f) -> Point2f:
        """(phi / 2 pi, theta / pi) as seen from the middle of the bounding sphere, in the axes of the world."""
        d = dr.normalize(p - self.ball_center)
        phi = dr.atan2(d.y, d.x) * (1 / (2 * math.pi))
        return Point2f(dr.select(phi < 0, phi + 1, phi), dr.safe_acos(d.z) * (1 / math.pi))

    def partials(self, p: Point3f) -> tuple[Vector3f, Vector3f]:
        """dp/du and dp/dv along the surface: the change of `uv`, with p kept on the tangent plane."""
        local, n = p - self.ball_center, self.normal_at(p)
        rim = dr.sqrt(dr.square(local.x) + dr.square(local.y))
        inv_rim = dr.select(rim > 0, dr.rcp(rim), 0)
        cos, sin = dr.select(rim > 0, local.x * inv_rim, 1), local.y * inv_rim
        du = 2 * math.pi * Vector3f(-local.y, local.x, 0)
        dv = math.pi * Vector3f(local.z * cos, local.z * sin, -rim)
        # The distance from the centre changes as well: move along `local` back onto the tangent plane.
        across = dr.dot(local, n)
        inv = dr.select(dr.abs(across) > 1e-6 * dr.norm(local), dr.rcp(across), 0)
        return du - local * (dr.dot(du, n) * inv), dv - local * (dr.dot(dv, n) * inv)

    # ---- as a light ------------------------------------------------------------------

    def _cone(self, ref: Point3f) -> tuple[Vector3f, Float]:
        """The axis of the cone of directions to the bounding sphere, and 1 - cos of its half-angle; 2 from within."""
        to_center = self.ball_center - ref
        dist_squared = dr.squared_norm(to_center)
        sin_squared = dr.square(self.ball_radius) * dr.rcp(dist_squared)
        cos = dr.safe_sqrt(1 - sin_squared)
        outside = sin_squared < 1
        axis = dr.select(dist_squared > 0, to_center * dr.rsqrt(dist_squared), Vector3f(0, 0, 1))
        return axis, dr.select(outside, sin_squared * dr.rcp(1 + cos), 2)

    def draw_direction(self, ref: Point3f, sample: Point2f) -> DirectionSample3f:
        axis, opening = self._cone(ref)
        drop = opening * sample.x
        cos, sin = 1 - drop, dr.safe_sqrt(drop * (2 - drop))
        sin_phi, cos_phi = dr.sincos(2 * math.pi * sample.y)
        d = Frame3f.from_normal(axis).to_world(Vector3f(cos_phi * sin, sin_phi * sin, cos))
        # The reference point may lie on this surface itself.
        a = dr.abs(ref)
        step = dr.fma(maximum(maximum(a.x, a.y), a.z), RAY_EPSILON, RAY_EPSILON)
        zero = self.search(Ray3f(dr.fma(d, step, ref), d), Float(dr.inf))
        dist = dr.select(zero.found, zero.t + step, self.ball_radius + dr.norm(self.ball_center - ref))
        p = dr.fma(d, dist, ref)
        # Without a hit the normal is turned away from `ref`, so that no light comes from there.
        n = dr.select(zero.found, self.normal_at(p), d)
        weight = 2 * math.pi * opening
        return DirectionSample3f.of(p, n, self.uv(p), d, dist, dr.rcp(weight), weight, Bool(False), UInt32(0))

    def direction_density(self, ref: Point3f, ds: DirectionSample3f) -> Float:
        _, opening = self._cone(ref)
        return dr.rcp(2 * math.pi * opening)


def gradient(f: Callable[[Point3f], Float], p: Point3f) -> Vector3f:
    """The gradient of `f` at some points by automatic differentiation; the result is detached."""
    with dr.resume_grad():
        q = Point3f(dr.detach(p))
        dr.enable_grad(q)
        dr.backward(f(q))
        return Vector3f(dr.grad(q))


# ---- the first zero of a function along a ray --------------------------------------------------------------------


REFINEMENTS = 40
"""Most evaluations after a zero was bracketed; about 6 are needed."""

MOST_STEPS = 1 << 17
"""Most evaluations of a function; bounds the search whatever the function returns."""

NARROW = 2.0**-22
"""Relative width of a bracket that float32 can't narrow further."""


@dataclass
class Zero:
    """The first change of sign of a function along a ray."""

    found: Bool
    t: Float


@dataclass
class Search:
    """Loop state. The sign of `f` is turned so that it is positive at the start."""

    t: Float
    """The distance at which `f` is evaluated next."""
    low: Float
    f_low: Float
    high: Float
    f_high: Float
    count: UInt32
    """The number of times that the bracket was narrowed."""
    tries: UInt32
    """The number of evaluations."""
    bracketed: Bool
    crossed: Bool
    """Whether the last point was beyond the zero."""
    active: Bool


def first_zero(f: Callable[[Float], Float], start: Float, end: Float, reach: Float, least: Float, active: Bool) -> Zero:
    """The first change of sign of `f` between `start` and `end`, where `active`.

    From each point the search goes on by abs(f) times `reach`, but at least by `least`: with 1 / reach a bound of
    abs(f') no zero is left out (J. C. Hart, "Sphere Tracing", The Visual Computer 12, 1996), except pairs of zeros
    closer than `least`. With reach = 0 all steps are `least`. Once the sign has changed, the zero is narrowed down
    by false position with Illinois' rule, every fourth time by bisection, to the last digits that `f` has. One loop
    with one evaluation of `f`, so that lanes don't wait for each other's phase.
    """
    first = f(start)
    inside = first < 0
    width = max(dr.width(first), dr.width(end), dr.width(active))

    def onward(low: Float, f_low: Float) -> Float:
        # Far from the origin `least` may be less than the distance to the next number.
        t = low + dr.maximum(dr.maximum(f_low * reach, least), NARROW * low)
        return dr.select(t < end, t, end)

    def step(s: Search) -> Search:
        value = f(s.t)
        value = dr.select(inside, -value, value)
        crossed = value <= 0
        # Illinois: an end that stays for the second time counts half, so that it will move.
        weight = dr.select(s.bracketed & (crossed == s.crossed), Float(0.5), Float(1))
        f_low, f_high = dr.select(crossed, s.f_low * weight, value), dr.select(crossed, value, s.f_high * weight)
        low, high = dr.select(crossed, s.low, s.t), dr.select(crossed, s.t, s.high)
        bracketed = s.bracketed | crossed
        secant = low + (high - low) * (f_low * dr.rcp(f_low - f_high))
        middle = 0.5 * (low + high)
        bisect = ~((secant > low) & (secant < high)) | ((s.count & 3) == 3)
        narrower = dr.select(bisect, middle, secant)
        settled = bracketed & ((value == 0) | (high - low <= NARROW * high) | (s.count > REFINEMENTS))
        over = (~bracketed & (s.t >= end)) | (s.tries > MOST_STEPS)
        t = dr.select(bracketed, dr.select(settled, s.t, narrower), onward(low, f_low))
        count = dr.select(bracketed, s.count + 1, s.count)
        tries = s.tries + 1
        return Search(t, low, f_low, high, f_high, count, tries, bracketed, crossed, s.active & ~settled & ~over)

    zero, no = dr.zeros(Float, width), dr.full(Bool, False, width)
    distance = dr.abs(first)
    search = Search(
        onward(start, distance) + zero,
        start + zero,
        distance + zero,
        end + zero,
        Float(zero),
        dr.zeros(UInt32, width),
        dr.zeros(UInt32, width),
        no,
        Bool(no),
        active & (start < end) & ~no,
    )
    (search,) = while_loop((search,), lambda s: s.active, lambda s: (step(s),), labels=("search",))
    return Zero(search.bracketed, search.t)
