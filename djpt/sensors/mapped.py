"""What cameras share that see wide angles: rays through one point, and a plane that directions are mapped to."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import DirectionSample3f, Ray3f
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.jit.kernels import as_float, as_vector
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.sensors.projective import ProjectiveCamera

if TYPE_CHECKING:
    pass

__all__ = ["MappedCamera"]


class MappedCamera(ProjectiveCamera):
    """A camera whose rays meet in one point, and whose film shows a map of their directions.

    Directions are those of camera space (+x left, +y up, +z ahead), of unit length. A subclass maps them to a plane, of
    which the film shows a rectangle (`window`): `to_direction`, its inverse `to_plane`, and how much larger areas of
    the plane are than solid angles (`spread`).

    Film positions outside of the circle of directions that the lens shows see nothing: they are black, with an alpha of
    0.

    Parameters, besides those of all sensors: `near_clip` (0.01) and `far_clip` (10000), distances from the camera: rays
    start at the one and end at the other.
    """

    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(
        ("origin", "axis_x", "axis_y", "axis_z", "corner", "step", "near", "depth"), ParamFlags.NonDifferentiable
    )
    can_be_reached = True
    is_central = True
    is_pinhole = True
    in_any_frame = True
    lens: ClassVar[tuple[str, ...]] = ()
    """The parameters of the map: numbers."""

    origin: Point3f
    axis_x: Vector3f
    axis_y: Vector3f
    axis_z: Vector3f
    corner: Point2f
    """The point of the plane that film position (0, 0) shows."""
    step: Point2f
    """The way on the plane from there to what (1, 1) shows."""
    near: Float
    depth: Float
    rim: Float
    """The radius on the plane of the circle of what the lens shows; only if the film reaches past it."""

    # ---- the map -----------------------------------------------------------------------

    def window(self, values: Mapping[str, Any]) -> tuple[Any, Any]:
        """The film's `corner` and `step` on the plane: pairs of numbers, or of `Float` if some of `values` are.

        `values` are the numbers of the lens by name.
        """
        raise NotImplementedError

    def to_direction(self, q: Point2f) -> Vector3f:
        """The direction that is mapped to a point of the plane."""
        raise NotImplementedError

    def to_plane(self, d: Vector3f) -> tuple[Point2f, Bool]:
        """The point of the plane that a direction is mapped to, and whether there is one."""
        raise NotImplementedError

    def spread(self, d: Vector3f) -> Float:
        """The area of the plane per solid angle about a direction that is mapped to it."""
        raise NotImplementedError

    # ---- parameters --------------------------------------------------------------------

    def traverse_lens(self, callback: TraversalCallback) -> None:
        for name in self.lens:
            callback.put(name, getattr(self, name), self.motion_flags(name))

    def numbers(self) -> dict[str, float]:
        """The numbers of the lens by name."""
        return {name: float(dr.detach(getattr(self, name))[0]) for name in self.lens}

    # ---- on the host -------------------------------------------------------------------

    def place(self) -> None:
        linear = self.to_world.matrix[:3, :3]
        self.origin = Point3f(as_vector(self.to_world.translation()))
        self.axis_x, self.axis_y, self.axis_z = (as_vector(linear[:, k]) for k in range(3))
        corner, step = self.window(self.numbers())
        self.corner, self.step = (Point2f(*(as_float(float(v)) for v in pair)) for pair in (corner, step))
        self.near, self.depth = as_float(self._near_clip), as_float(self._far_clip - self._near_clip)

    def moved_rays(self, values: Mapping[str, Any]) -> dict[str, Any]:
        from djpt.sensors.moving import columns  # images of still cameras need none of it

        x, y, z, origin = columns(self, values)
        corner, step = self.window({**self.numbers(), **{k: v for k, v in values.items() if k in self.lens}})
        placed = {"origin": origin, "axis_x": x, "axis_y": y, "axis_z": z}
        of_lens = {name: value for name, value in values.items() if name in type(self).values}
        return {**placed, "corner": Point2f(*corner), "step": Point2f(*step), **of_lens}

    def film_window(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The corner of the crop window and the way across it, in shares of the whole film."""
        film = self.film()
        size, crop, offset = (
            np.array(pair, np.float64) for pair in (film.size(), film.crop_size(), film.crop_offset())
        )
        return offset / size, crop / size

    # ---- in kernels --------------------------------------------------------------------

    def viewpoint_radius(self) -> float:
        """How far from `origin` the places are from which points are seen."""
        return 0.0

    def sight(self, ref: Point3f) -> tuple[Point3f, Bool | bool]:
        """The place from which a point is seen, and whether there is one."""
        return self.origin, True

    def to_world_space(self, d: Vector3f) -> Vector3f:
        """A direction of camera space in the world."""
        return dr.fma(self.axis_x, d.x, dr.fma(self.axis_y, d.y, self.axis_z * d.z))

    def to_camera_space(self, d: Vector3f) -> Vector3f:
        """The inverse of `to_world_space`."""
        return Vector3f(dr.dot(d, self.axis_x), dr.dot(d, self.axis_y), dr.dot(d, self.axis_z))

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        q, maxt = dr.fma(self.step, film_position, self.corner), self.depth
        if self.has_image_circle:
            shown = self.in_circle(q)
            q, maxt = dr.select(shown, q, 0), dr.select(shown, maxt, 0)
        d = self.to_world_space(self.to_direction(q))
        return Ray3f(dr.fma(d, self.near, self.origin), d, maxt=maxt)

    def middle(self) -> Point2f:
        return Point2f(-self.corner.x / self.step.x, -self.corner.y / self.step.y)

    def edge_of_view(self, turn: Float) -> Point2f:
        sin, cos = dr.sincos(2 * math.pi * turn)
        return Point2f((self.rim * cos - self.corner.x) / self.step.x, (self.rim * sin - self.corner.y) / self.step.y)

    def in_circle(self, q: Point2f) -> Bool:
        """Whether a point of the plane lies within the circle of what the lens shows."""
        return dr.squared_norm(dr.detach(q)) <= dr.square(dr.detach(self.rim))

    def sample_wi(
        self, ref: Point3f, aperture_sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Float]:
        start, shown = self.sight(ref)
        to_ref = ref - start
        distance_squared = dr.squared_norm(to_ref)
        inverse = dr.rsqrt(dr.select(distance_squared > 0, distance_squared, 1))
        distance, d = distance_squared * inverse, Vector3f(to_ref * inverse)
        local = self.to_camera_space(d)
        q, mapped = self.to_plane(local)
        uv = Point2f((q.x - self.corner.x) / self.step.x, (q.y - self.corner.y) / self.step.y)
        if self.has_image_circle:
            mapped = mapped & self.in_circle(q)
            uv = dr.select(mapped, uv, -1)
        in_range = (distance > self.near) & (distance < self.near + self.depth)
        seen = mapped & shown & in_range & (uv.x >= 0) & (uv.x < 1) & (uv.y >= 0) & (uv.y < 1)
        ds = DirectionSample3f.of(
            p=dr.fma(d, self.near, start),
            n=d,
            uv=uv,
            d=-d,
            dist=distance - self.near,
            pdf=Float(1),
            weight=Float(1),
            delta=Bool(True),
            emitter_index=UInt32(0),
        )
        return ds, dr.select(seen, self.density(local) * dr.square(inverse), 0)

    def sample_direction(
        self, it: Any, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """See `SampledRays`; `ds.p` is the camera's place, and `ds.dist` the distance from there."""
        ds, importance = super().sample_direction(it, sample, active)
        ds.p, ds.dist, ds.delta = dr.fma(ds.d, self.near, ds.p), ds.dist + self.near, Bool(False)
        return ds, importance

    def density(self, local: Vector3f) -> Float:
        """The density of directions for film positions that are uniform on the crop window, per unit solid angle."""
        return self.spread(local) * dr.rcp(dr.abs(self.step.x * self.step.y))

    def pdf_ray(self, ray: Ray3f) -> tuple[Float, Float]:
        """See `Sensor`: the density, and `near_clip`."""
        return self.density(self.to_camera_space(ray.d)), self.near
