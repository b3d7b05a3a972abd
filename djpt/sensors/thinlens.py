"""The camera with a thin lens: depth of field."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr

from djpt.core.numeric import as_number
from djpt.core.records import DirectionSample3f, Ray3f
from djpt.core.warp import square_to_uniform_disk_concentric
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.errors import ParameterError
from djpt.jit.kernels import as_float, as_vector
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.sensors.projective import Central

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["ThinLens"]

LENS = ("aperture_radius", "focus_distance")
MOTIONS = ("attached_matrix", "x_fov", "aperture_radius", "_focus_distance")
VIEW_CAMERA = (
    *("aperture_blades", "aperture_rotation", "aperture_roundness", "tilt", "swing"),
    *("principal_point_offset_x", "principal_point_offset_y"),
)
"""Entries of lenses with blades, tilt or shift."""


class ThinLens(Central):
    """A camera with an ideal thin lens: what is at the focus distance is sharp.

    With m the direction of the pinhole camera's ray, per unit along the optical axis, and a a point drawn
    uniformly on the lens, the ray starts at a and meets that of the pinhole in the plane of focus:

        o = a,    d = m - a / focus_distance

    A point at depth z is blurred to a disk of radius aperture_radius abs(1 / z - 1 / focus_distance), as a tangent
    of an angle.

    Parameters: those of `perspective` without the principal point, and `aperture_radius` (of the lens, in scene
    units, > 0, required), `focus_distance` (along the optical axis, > 0, default `far_clip`). With any of the entries
    of `djpt.sensors.viewcamera.ViewCamera`, aperture blades, tilt and shift, it is one of those.

    Source: R. L. Cook, T. Porter, L. Carpenter, "Distributed Ray Tracing", SIGGRAPH 1984.
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = {
        **Central.values,
        **dict.fromkeys(("lens_x", "lens_y", "inv_focus"), ParamFlags.NonDifferentiable),
    }
    uses_aperture = True
    density_moves = True
    motions: ClassVar[tuple[str, ...]] = MOTIONS

    def __new__(cls, props: Properties | None = None) -> ThinLens:
        """The class itself, or one with blades, tilt or shift if `props` says so; copies have no `props`."""
        if cls is ThinLens and props is not None and any(name in props for name in VIEW_CAMERA):
            from djpt.sensors.viewcamera import ViewCamera  # most cameras need none of it

            return super().__new__(ViewCamera)
        return super().__new__(cls)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.aperture_radius = Float(props.float("aperture_radius", low=0.0, low_open=True))
        self._focus_distance = Float(props.float("focus_distance", self._far_clip, low=0.0, low_open=True))
        self.place()

    def traverse_lens(self, callback: TraversalCallback) -> None:
        for name in ("aperture_radius", "_focus_distance", "x_fov"):
            callback.put(name.lstrip("_"), getattr(self, name), self.motion_flags(name), attribute=name)

    def move_lens(self, frame: Frame) -> None:
        self.aperture_radius = Float(self.aperture_radius[0] * frame.scale)
        self._focus_distance = Float(self._focus_distance[0] * frame.scale)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name not in LENS:
            return super().check_parameter(name, value)
        number = as_number(dr.detach(value))
        if number <= 0:
            raise ParameterError(f"must be greater than 0, found {number:g}")
        return Float(value) if dr.grad_enabled(value) else Float(number)

    def place(self) -> None:
        super().place()
        linear, radius = self.to_world.matrix[:3, :3], dr.detach(self.aperture_radius)[0]
        self.lens_x, self.lens_y = as_vector(linear[:, 0] * radius), as_vector(linear[:, 1] * radius)
        self.inv_focus = as_float(1 / dr.detach(self._focus_distance)[0])

    def moved_rays(self, values: Mapping[str, Any]) -> dict[str, Any]:
        from djpt.sensors.moving import lens_rays  # images of still cameras need none of it

        return lens_rays(self, values)

    def through_lens(self, aperture_sample: Point2f) -> Any:
        from djpt.sensors.moving import pinhole

        return pinhole(self, aperture_sample) if self.uses_aperture else self

    def lens_point(self, aperture_sample: Point2f) -> Vector3f:
        lens = self.aperture_point(aperture_sample)
        return Vector3f(self.lens_x * lens.x + self.lens_y * lens.y)

    def aperture_point(self, sample: Point2f) -> Point2f:
        """A point drawn uniformly on the aperture, in units of its radius: x to the left, y up."""
        return Point2f(square_to_uniform_disk_concentric(sample))

    def bent(self, m: Vector3f, lens: Vector3f) -> Vector3f:
        return m + lens * -self.inv_focus

    def straightened(self, m: Vector3f, lens: Vector3f) -> Vector3f:
        return m - lens * -self.inv_focus

    def aperture_area(self) -> Float:
        """The area of the aperture."""
        return math.pi * dr.square(self.aperture_radius)

    def sample_direction(
        self, it: Any, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """See `SampledRays`; `ds.pdf` is that of the point of the lens, per unit solid angle."""
        ds, importance = super().sample_direction(it, sample, active)
        ds.pdf = dr.square(ds.dist) * dr.rcp(self.aperture_area() * dr.abs(dr.dot(ds.d, self.axis)))
        return ds, importance

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        a = self.lens_point(aperture_sample)
        d = self.bent(self.through_centre(film_position), a)
        length_squared = dr.squared_norm(d)
        inv_length = dr.rsqrt(length_squared)
        o = dr.fma(d, self.near, self.origin + a)
        return Ray3f(o, d * inv_length, maxt=self.depth * (length_squared * inv_length))


register_sensor("thinlens", ThinLens)
