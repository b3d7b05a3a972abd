"""The pinhole camera."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from djpt.description.numeric import as_number
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import ParameterError
from djpt.lookup import as_float, as_vector
from djpt.records import Ray3f
from djpt.sensors.base import Sensor
from djpt.types import Bool, Float, Point2f

__all__ = ["Perspective"]

FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")
FRAME_DIAGONAL = math.hypot(36.0, 24.0)
"""Of 35 mm film, in mm: what `focal_length` refers to."""

DERIVED = ("origin", "corner", "across", "down", "near", "depth")


class Perspective(Sensor):
    """A pinhole camera: all rays through one point, the image plane upright.

    Parameters, besides those of all sensors: `fov` (degrees, in (0, 180), along `fov_axis`), or
    else `focal_length` (a string such as ``'50mm'``, the default, for 35 mm film); `fov_axis` (`x`,
    the default, `y`, `diagonal`, `smaller` or `larger` of the film's sides); `near_clip` (0.01) and
    `far_clip` (10000), measured along the optical axis; `principal_point_offset_x`, `_y` (0: shift
    of the image centre, in image widths and heights). `focus_distance` is accepted, without effect.

    The field of view refers to the whole film, also if only a crop of it is rendered. A ray starts
    on the near plane and ends on the far plane.
    """

    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(DERIVED, ParamFlags.NonDifferentiable)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.near_clip = props.float("near_clip", 1e-2, low=0.0, low_open=True)
        self.far_clip = props.float("far_clip", 1e4, low=0.0, low_open=True)
        if self.near_clip >= self.far_clip:
            raise props.error(
                "near_clip", f"must be less than 'far_clip' ({self.far_clip:g}), found {self.near_clip:g}"
            )
        props.float("focus_distance", self.far_clip)
        width, height = self.film.size
        self.x_fov = Float(horizontal_fov(props, width / height))
        self.principal_point_offset_x = Float(props.float("principal_point_offset_x", 0.0))
        self.principal_point_offset_y = Float(props.float("principal_point_offset_y", 0.0))
        self.parameters_changed(())

    # ---- parameters --------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("near_clip", self.near_clip)
        callback.put("far_clip", self.far_clip)
        super().traverse(callback)
        for name in ("x_fov", "principal_point_offset_x", "principal_point_offset_y", "to_world"):
            callback.put(name, getattr(self, name))

    def check_parameter(self, name: str, value: Any) -> Any:
        if name in ("x_fov", "principal_point_offset_x", "principal_point_offset_y"):
            number = as_number(value)
            if name == "x_fov" and not 0 < number < 180:
                raise ParameterError(f"must lie in (0, 180), found {number:g}")
            return Float(number)
        checked = super().check_parameter(name, value)
        if name in ("near_clip", "far_clip") and checked <= 0:
            raise ParameterError(f"must be greater than 0, found {checked:g}")
        return checked

    def parameters_changed(self, keys: Sequence[str]) -> None:
        if self.near_clip >= self.far_clip:
            raise ParameterError(
                f"{self.id}.near_clip: must be less than far_clip ({self.far_clip:g}), found {self.near_clip:g}"
            )
        # A film position (x, y) in the crop is (u, v) in the whole film; the ray through it
        # has the local direction ((1 - 2u) t, (1 - 2v) t / aspect, 1), t = tan(x_fov / 2).
        size, crop, offset = (
            np.array(pair, dtype=np.float64) for pair in (self.film.size, self.film.crop_size, self.film.crop_offset)
        )
        shift = np.array([self.principal_point_offset_x[0], self.principal_point_offset_y[0]])
        u, v = shift + offset / size
        t = math.tan(math.radians(self.x_fov[0]) / 2)
        reach = np.array([t, t * size[1] / size[0]])
        step = -2 * reach * crop / size

        linear = self.to_world.matrix[:3, :3]
        self.origin = as_vector(self.to_world.translation())
        self.corner = as_vector(linear @ [(1 - 2 * u) * reach[0], (1 - 2 * v) * reach[1], 1.0])
        self.across = as_vector(linear[:, 0] * step[0])
        self.down = as_vector(linear[:, 1] * step[1])
        self.near = as_float(self.near_clip)
        self.depth = as_float(self.far_clip - self.near_clip)

    # ---- in kernels --------------------------------------------------------------------

    def sample_ray(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        # Unit distance along the optical axis: lengths of this vector convert depth to distance.
        d = dr.fma(self.across, film_position.x, dr.fma(self.down, film_position.y, self.corner))
        length_squared = dr.squared_norm(d)
        inv_length = dr.rsqrt(length_squared)
        return Ray3f(dr.fma(d, self.near, self.origin), d * inv_length, self.depth * (length_squared * inv_length))


def horizontal_fov(props: Properties, aspect: float) -> float:
    """The field of view along x in degrees, from `fov` and `fov_axis` or from `focal_length`.

    `aspect` is width / height of the film.
    """
    if "fov" in props:
        if "focal_length" in props:
            raise props.error("focal_length", "can't be given together with 'fov'")
        fov = props.float("fov", low=0.0, high=180.0, low_open=True, high_open=True)
        axis = fov_axis(props, aspect)
    else:
        if "fov_axis" in props:
            raise props.error("fov_axis", "needs 'fov'; a focal length refers to the diagonal")
        fov = math.degrees(2 * math.atan(FRAME_DIAGONAL / (2 * focal_length(props))))
        axis = "diagonal"
    t = math.tan(math.radians(fov) / 2)
    if axis == "y":
        t *= aspect
    elif axis == "diagonal":
        t /= math.hypot(1.0, 1.0 / aspect)
    return math.degrees(2 * math.atan(t))


def fov_axis(props: Properties, aspect: float) -> str:
    """`x`, `y` or `diagonal`."""
    axis = props.string("fov_axis", "x").lower()
    if axis not in FOV_AXES:
        axis = props.string("fov_axis", choices=FOV_AXES)
    if axis == "smaller":
        return "y" if aspect > 1 else "x"
    if axis == "larger":
        return "x" if aspect > 1 else "y"
    return axis


def focal_length(props: Properties) -> float:
    """In millimetres; the unit may be left out."""
    text = props.string("focal_length", "50mm")
    try:
        millimetres = float(text.strip().removesuffix("mm"))
    except ValueError:
        millimetres = math.nan
    if not 0 < millimetres < math.inf:
        raise props.error("focal_length", f"must be a positive length such as '50mm', found '{text}'")
    return millimetres
