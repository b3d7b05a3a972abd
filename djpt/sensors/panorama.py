"""The panorama: a camera that sees all around."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.numeric import as_number
from djpt.core.records import Ray3f
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.errors import ParameterError
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Float, Point2f, Point3f, Vector3f
from djpt.sensors.mapped import MappedCamera

__all__ = ["Panorama"]

EYES = {"centre": 0.0, "left": 1.0, "right": -1.0}
"""On which side of the centre an eye is, along the camera's +x, which points to the left."""
RANGES = ("azimuth", "elevation")


class Panorama(MappedCamera):
    """A camera whose columns are azimuths and whose rows are elevations: an equirectangular picture.

    With the azimuth phi, to the right of the direction of view, and the elevation e above the horizon,

        d = (-cos(e) sin(phi), sin(e), cos(e) cos(phi))    in camera space, where +x points to the left.

    A whole panorama is an environment map: an `envmap` with the same `to_world` lights a scene as seen from there.

    With `eye` = `left` or `right` the rays of each column start where that eye of a head that looks along the column is
    (omnidirectional stereo): at half of `eye_distance` from the centre, across the horizontal direction of the column.
    Such rays are tangents of a cylinder of radius r = eye_distance / 2 instead of meeting in one point. A point at the
    distance D from the cylinder's axis is seen along the tangent on the eye's side, whose horizontal length is
    sqrt(D^2 - r^2); what is within the cylinder isn't seen.

    Parameters, besides those of `MappedCamera`: `azimuth_from`, `azimuth_to` (degrees, default -180 and 180, at most
    360 apart: the film's left and right edge), `elevation_from`, `elevation_to` (default -90 and 90: the film's lower
    and upper edge), `eye` (`centre`, the default, `left` or `right`), `eye_distance` (default 0.065, without effect at
    the centre).

    Source: S. Peleg, M. Ben-Ezra, Y. Pritch, "Omnistereo: Panoramic Stereo Imaging", IEEE TPAMI 23 (2001).
    """

    values: ClassVar[Mapping[str, ParamFlags]] = {**MappedCamera.values, "aside": ParamFlags.NonDifferentiable}
    statics = ("eye",)
    lens = ("azimuth_from", "azimuth_to", "elevation_from", "elevation_to")
    motions = ("attached_matrix", *lens)
    in_any_frame = True

    azimuth_from: Float
    azimuth_to: Float
    elevation_from: Float
    elevation_to: Float
    eye_distance: Float
    aside: Float
    """How far to the left of the centre, seen along a column, its rays start."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        for name, default in zip(self.lens, (-180.0, 180.0, -90.0, 90.0), strict=True):
            setattr(self, name, Float(props.float(name, default)))
        self.eye = props.string("eye", "centre", choices=tuple(EYES))
        self.eye_distance = Float(props.float("eye_distance", 0.065, low=0.0))
        problem = self.problem()
        if problem is not None:
            raise props.error(*problem)
        self.is_central = self.is_pinhole = self.eye == "centre"  # type: ignore[misc]
        if self.eye != "centre":
            self.motions = (*type(self).motions, "eye_distance")  # type: ignore[assignment, misc]
        self.place()

    def problem(self) -> tuple[str, str] | None:
        """The entry that can't be, and why."""
        numbers = self.numbers()
        for name in RANGES:
            low, high = numbers[f"{name}_from"], numbers[f"{name}_to"]
            if not low < high:
                return f"{name}_to", f"must be greater than '{name}_from' ({low:g}), found {high:g}"
        if numbers["azimuth_to"] - numbers["azimuth_from"] > 360 * (1 + 1e-6):
            return "azimuth_to", f"must be at most 360 more than 'azimuth_from', found {numbers['azimuth_to']:g}"
        for name in ("elevation_from", "elevation_to"):
            if abs(numbers[name]) > 90:
                return name, f"must lie in [-90, 90], found {numbers[name]:g}"
        return None

    # ---- parameters --------------------------------------------------------------------

    def traverse_lens(self, callback: Any) -> None:
        super().traverse_lens(callback)
        callback.put("eye_distance", self.eye_distance, self.motion_flags("eye_distance"))

    def check_parameter(self, name: str, value: Any) -> Any:
        if name not in (*self.lens, "eye_distance"):
            return super().check_parameter(name, value)
        number = as_number(dr.detach(value))
        if name == "eye_distance" and number < 0:
            raise ParameterError(f"must be at least 0, found {number:g}")
        return Float(value) if dr.grad_enabled(value) else Float(number)

    def parameters_changed(self, keys: Any) -> None:
        problem = self.problem()
        if problem is not None:
            raise ParameterError(f"{self.id()}.{problem[0]}: {problem[1]}")
        super().parameters_changed(keys)

    def move_lens(self, frame: Any) -> None:
        self.eye_distance = Float(self.eye_distance[0] * frame.scale)

    # ---- on the host -------------------------------------------------------------------

    def place(self) -> None:
        super().place()
        self.aside = as_float(self.viewpoint_radius() * EYES[self.eye])

    def viewpoint_radius(self) -> float:
        return 0.5 * float(dr.detach(self.eye_distance)[0]) * abs(EYES[self.eye])

    def moved_rays(self, values: Mapping[str, Any]) -> dict[str, Any]:
        moved = super().moved_rays(values)
        if "eye_distance" in values:
            moved["aside"] = values["eye_distance"] * (0.5 * EYES[self.eye])
        return moved

    def window(self, values: Mapping[str, Any]) -> tuple[Any, Any]:
        radians = math.pi / 180
        left, right = values["azimuth_from"], values["azimuth_to"]
        lower, upper = values["elevation_from"], values["elevation_to"]
        offset, share = (tuple(map(float, pair)) for pair in self.film_window())
        across, down = (right - left) * radians, (lower - upper) * radians
        corner = (left * radians + across * offset[0], upper * radians + down * offset[1])
        return corner, (across * share[0], down * share[1])

    # ---- the map: a plane of azimuths and elevations -------------------------------------

    def to_direction(self, q: Point2f) -> Vector3f:
        sin_phi, cos_phi = dr.sincos(q.x)
        sin_e, cos_e = dr.sincos(q.y)
        return Vector3f(-cos_e * sin_phi, sin_e, cos_e * cos_phi)

    def to_plane(self, d: Vector3f) -> tuple[Point2f, Bool]:
        phi, turn = dr.atan2(-d.x, d.z), 2 * math.pi
        # The azimuth of the turn that begins at the film's left edge.
        start = dr.detach(self.corner.x)
        phi = phi - turn * dr.floor((dr.detach(phi) - start) * (1 / turn))
        # Near the poles an arc sine would round the elevation.
        level = dr.sqrt(dr.maximum(dr.square(d.x) + dr.square(d.z), 1e-20))
        return Point2f(phi, dr.atan2(d.y, level)), Bool(True)

    def spread(self, d: Vector3f) -> Float:
        return dr.rcp(dr.sqrt(dr.maximum(dr.square(d.x) + dr.square(d.z), 1e-20)))

    def sight(self, ref: Point3f) -> tuple[Point3f, Bool | bool]:
        if self.eye == "centre":
            return super().sight(ref)
        local = self.to_camera_space(ref - self.origin)
        # In the plane of the horizon p = left r + ahead s, and ahead is left, turned by 90 degrees.
        squared = dr.square(local.x) + dr.square(local.z)
        s = dr.safe_sqrt(squared - dr.square(self.aside))
        inverse = dr.rcp(dr.maximum(squared, 1e-20))
        left_x = dr.fma(local.x, self.aside, local.z * s) * inverse
        left_z = dr.fma(local.z, self.aside, -local.x * s) * inverse
        left = self.to_world_space(Vector3f(left_x, 0, left_z))
        return dr.fma(left, self.aside, self.origin), s > 0

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        ray = super().ray_through(film_position, aperture_sample, active)
        if self.eye == "centre":
            return ray
        sin_phi, cos_phi = dr.sincos(dr.fma(self.step.x, film_position.x, self.corner.x))
        left = self.to_world_space(Vector3f(cos_phi, 0, sin_phi))
        return ray.replaced(o=dr.fma(left, self.aside, ray.o))

    def starts(self) -> Any:
        """The points near which rays start: on a circle for an eye beside the centre."""
        found = list(super().starts())
        if self.eye == "centre":
            return found
        linear, radius = self.to_world.matrix[:3, :3], self.viewpoint_radius()
        return [p + linear @ (radius * np.array(side)) for p in found for side in ((1, 0, 0), (-1, 0, 0))]


register_sensor("panorama", Panorama)
