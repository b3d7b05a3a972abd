"""The lens of a view camera: an aperture with blades, a tilted plane of focus, a shifted image."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_number
from djpt.core.records import DirectionSample3f, Ray3f
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import ParameterError
from djpt.jit.kernels import as_float, as_vector
from djpt.jit.types import Bool, Float, Point2f, Point3f, Vector3f
from djpt.sensors.perspective import OFFSETS
from djpt.sensors.thinlens import MOTIONS, ThinLens

__all__ = ["ViewCamera"]

TILTS = ("tilt", "swing")
ROUNDING_STEPS = 4
"""Steps of Newton's method from a random number to a direction in a rounded aperture."""


class ViewCamera(ThinLens):
    """A `thinlens` camera with aperture blades, a tilted plane of focus, and a shifted image.

    The plane of focus meets the optical axis at `focus_distance` F. Its top leans away from the camera by the angle
    `tilt`, and its right side by `swing`: with x to the left, y up and z ahead, it is

        z = F + tan(tilt) y - tan(swing) x,    that is g . p = 1,    g = (tan(swing), -tan(tilt), 1) / F

    With m the direction of the pinhole camera's ray, per unit along the optical axis, and a a point drawn uniformly on
    the aperture, which is parallel to the film, a ray is

        o = a,    d = m - (g . m) a    so that    m = d + (g . d) a / (1 - g . a)

    By the rule of Scheimpflug a lens of focal length f that is turned against the film by an angle alpha has such a
    plane of focus: tan(tilt) = F sin(alpha) / f.

    The aperture is a regular polygon with `aperture_blades` edges, its corners at the distance `aperture_radius` from
    the axis. With roundness k, the squares of the distances of its edge lie between those of the polygon and those of
    the circle, k of the way; so do areas. Blurred lights behind the plane of focus have the shape of the aperture as
    seen from behind the camera, those before it the same upside down.

    Parameters, besides those of `thinlens`: `aperture_blades` (an integer of at least 3, or 0, the default: a circle),
    `aperture_rotation` (degrees, default 0: a corner is on top; counterclockwise, seen from behind the camera),
    `aperture_roundness` (in [0, 1], default 0), `tilt` and `swing` (degrees, in (-90, 90), default 0),
    `principal_point_offset_x`, `_y` (default 0: shift of the image's centre, in image widths and heights, as in
    `perspective`).

    Source: L. Larmore, "Introduction to Photographic Principles", 1965 (the rule of Scheimpflug).
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = {
        **{name: flags for name, flags in ThinLens.values.items() if name != "inv_focus"},
        **dict.fromkeys(("focus", "blades", "turn", "roundness", "aperture"), ParamFlags.NonDifferentiable),
    }
    statics = ("polygonal", "rounded")
    density_moves = False
    focus: Vector3f
    """g in world space: its product with a point, relative to the lens, is 1 on the plane of focus."""
    blades: Float
    turn: Float
    """`aperture_rotation` in radians."""
    roundness: Float
    aperture: Float
    """The area of the aperture of radius 1."""

    def __init__(self, props: Properties) -> None:
        self.tilt, self.swing = (
            Float(props.float(name, 0.0, low=-90.0, high=90.0, low_open=True, high_open=True)) for name in TILTS
        )
        self.principal_point_offset_x, self.principal_point_offset_y = (Float(props.float(n, 0.0)) for n in OFFSETS)
        self.aperture_blades = props.integer("aperture_blades", 0)
        problem = problem_of_blades(self.aperture_blades)
        if problem is not None:
            raise props.error("aperture_blades", problem)
        self.polygonal, self.rounded = self.aperture_blades > 0, "aperture_roundness" in props
        for name in ("aperture_rotation", "aperture_roundness"):
            if name in props and not self.polygonal:
                raise props.error(name, "needs 'aperture_blades': the aperture is a circle")
        self.aperture_rotation = Float(props.float("aperture_rotation", 0.0))
        self.aperture_roundness = Float(props.float("aperture_roundness", 0.0, low=0.0, high=1.0))
        of_edge = (("aperture_rotation",) if self.polygonal else ()) + (("aperture_roundness",) if self.rounded else ())
        self.motions = (*MOTIONS, *TILTS, *OFFSETS, *of_edge)  # type: ignore[misc]
        super().__init__(props)
        problem = self.problem()
        if problem is not None:
            raise props.error("tilt", problem)

    def problem(self) -> str | None:
        """The reason why the plane of focus can't be where it is."""
        radius, distance = (float(dr.detach(v)[0]) for v in (self.aperture_radius, self._focus_distance))
        slope = math.hypot(*self.slopes())
        if radius * slope < distance:
            return None
        return (
            f"must not turn the plane of focus until it cuts the lens: 'aperture_radius' ({radius:g}) times the "
            f"tangent of its angle ({slope:.4g}) must be less than 'focus_distance' ({distance:g})"
        )

    def slopes(self) -> tuple[float, float]:
        """The tangents of the angles of `tilt` and `swing`."""
        tilt, swing = (math.tan(math.radians(float(dr.detach(getattr(self, name))[0]))) for name in TILTS)
        return tilt, swing

    # ---- parameters --------------------------------------------------------------------

    def traverse_lens(self, callback: TraversalCallback) -> None:
        super().traverse_lens(callback)
        for name in (*TILTS, *OFFSETS):
            callback.put(name, getattr(self, name), self.motion_flags(name))
        if self.polygonal:
            callback.put("aperture_blades", self.aperture_blades, ParamFlags.NonDifferentiable)
            for name in self.motions[-1 - self.rounded :]:
                callback.put(name, getattr(self, name), self.motion_flags(name))

    def check_parameter(self, name: str, value: Any) -> Any:
        if name == "aperture_blades":
            number = as_number(value)
            problem = problem_of_blades(number)
            if problem is not None or number == 0:
                raise ParameterError(problem or "must be at least 3: load a lens without blades for a circle")
            return int(number)
        if name not in (*TILTS, *OFFSETS, "aperture_rotation", "aperture_roundness"):
            return super().check_parameter(name, value)
        number = as_number(dr.detach(value))
        if name in TILTS and not abs(number) < 90:
            raise ParameterError(f"must lie in (-90, 90), found {number:g}")
        if name == "aperture_roundness" and not 0 <= number <= 1:
            raise ParameterError(f"must lie in [0, 1], found {number:g}")
        return Float(value) if dr.grad_enabled(value) else Float(number)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        problem = self.problem()
        if problem is not None:
            raise ParameterError(f"{self.id()}.tilt: {problem}")
        super().parameters_changed(keys)

    # ---- on the host -------------------------------------------------------------------

    def image_shift(self) -> NDArray[np.float64]:
        return np.array([float(dr.detach(getattr(self, name))[0]) for name in OFFSETS])

    def place(self) -> None:
        super().place()
        tilt, swing = self.slopes()
        linear, distance = self.to_world.matrix[:3, :3], float(dr.detach(self._focus_distance)[0])
        self.focus = as_vector(linear @ np.array([swing, -tilt, 1.0]) / distance)
        self.blades = as_float(max(self.aperture_blades, 3))
        self.turn = as_float(math.radians(float(dr.detach(self.aperture_rotation)[0])))
        k, angle = float(dr.detach(self.aperture_roundness)[0]), 2 * math.pi / max(self.aperture_blades, 3)
        self.roundness = as_float(k)
        polygon = math.pi / angle * math.sin(angle) if self.polygonal else math.pi
        self.aperture = as_float((1 - k) * polygon + k * math.pi)

    def moved_rays(self, values: Mapping[str, Any]) -> dict[str, Any]:
        from djpt.sensors.moving import columns, dual  # images of still cameras need none of it

        moved = super().moved_rays(values)
        inverse = moved.pop("inv_focus")
        x, y, z, _ = columns(self, values)
        to_x, to_y, to_z = dual(x, y, z)
        angles = (values.get(name, dr.detach(getattr(self, name))) for name in TILTS)
        tilt, swing = (dr.tan(angle * (math.pi / 180)) for angle in angles)
        moved["focus"] = (to_x * swing - to_y * tilt + to_z) * inverse
        if "aperture_rotation" in values:
            moved["turn"] = values["aperture_rotation"] * (math.pi / 180)
        if "aperture_roundness" in values:
            moved["roundness"] = values["aperture_roundness"]
        return moved

    def through_lens(self, aperture_sample: Point2f) -> Any:
        view = super().through_lens(aperture_sample)
        if view is self:
            return self
        from djpt.sensors.moving import dual

        # Its film is sheared along the lens, since rays are bent in proportion to g . m.
        with dr.resume_grad():
            lens = self.lens_point(dr.detach(aperture_sample))
            view.across, view.down = self.bent(self.across, lens), self.bent(self.down, lens)
            view.to_column, view.to_row, _ = dual(view.across, view.down, self.axis)
            view.inv_area = self.inv_area * dr.rcp(1 - dr.dot(self.focus, lens))
        return view

    # ---- in kernels --------------------------------------------------------------------

    def aperture_point(self, sample: Point2f) -> Point2f:
        if not self.polygonal:
            return super().aperture_point(sample)
        half = math.pi * dr.rcp(self.blades)
        place = sample.x * self.blades
        blade = dr.floor(place)
        along = dr.fma(2, place - blade, -1)  # in [-1, 1): the way along the blade's edge
        sin, height = dr.sincos(half)
        slope = sin * dr.rcp(height)
        square = dr.square(height)
        if self.rounded:
            slope = self.rounded_slope(along, slope, square)
            square = dr.fma(1 - self.roundness, square, self.roundness * dr.rcp(1 + dr.square(slope)))
        else:
            slope = along * slope
        reach = dr.sqrt(square * sample.y)
        # Up and to the left, with the middle of the blade on top; then turned there.
        sin, cos = dr.sincos(dr.fma(dr.fma(2, blade, 1), half, self.turn))
        return Point2f(reach * dr.fma(cos, slope, sin), reach * dr.fma(-sin, slope, cos))

    def rounded_slope(self, along: Float, last: Float, square: Float) -> Float:
        """The tangent of the angle with a blade's middle before which the share `along` of its area lies.

        The area up to the tangent s is in proportion to (1 - k) h^2 s + k atan(s), h^2 the `square`. Its inverse has
        the derivatives of one step of Newton's method from the solution.
        """

        def nearer(s: Float) -> Float:
            k = self.roundness
            of_polygon = (1 - k) * square
            area = of_polygon * s + k * dr.atan(s)
            whole = of_polygon * last + k * dr.atan(last)
            growth = of_polygon + k * dr.rcp(1 + dr.square(s))
            return s - (area - along * whole) * dr.rcp(dr.detach(growth))

        with dr.suspend_grad():
            slope = dr.detach(along * last)
            for _ in range(ROUNDING_STEPS):
                slope = nearer(slope)
        return nearer(dr.detach(slope))

    def bent(self, m: Vector3f, lens: Vector3f) -> Vector3f:
        return m - lens * dr.dot(self.focus, m)

    def straightened(self, m: Vector3f, lens: Vector3f) -> Vector3f:
        return m + lens * (dr.dot(self.focus, m) * self.narrowing(lens))

    def narrowing(self, lens: Vector3f) -> Float:
        """How much more densely than those through the centre the rays through a point of the lens lie.

        1 / (1 - g . a): the inverse of the determinant of `bent`, across the axis.
        """
        return dr.rcp(1 - dr.dot(self.focus, lens))

    def aperture_area(self) -> Float:
        return self.aperture * dr.square(dr.detach(self.aperture_radius))

    def sample_wi(
        self, ref: Point3f, aperture_sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Float]:
        ds, importance = super().sample_wi(ref, aperture_sample, active)
        return ds, importance * self.narrowing(self.lens_point(aperture_sample))

    def pdf_ray(self, ray: Ray3f) -> tuple[Float, Float]:
        """See `Central`; as densely as the rays through the point of the lens lie that the ray comes from."""
        pdf, distance = super().pdf_ray(ray)
        return pdf * self.narrowing(dr.fma(ray.d, -distance, ray.o) - self.origin), distance


def problem_of_blades(number: float) -> str | None:
    """The reason why an aperture can't have so many blades."""
    if number == 0 or (number >= 3 and number == int(number)):
        return None
    return f"must be 0 (a circle) or a whole number of at least 3, found {number:g}"
