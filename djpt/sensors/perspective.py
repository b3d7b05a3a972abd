"""The pinhole camera."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_number
from djpt.core.records import Ray3f
from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.jit.types import Bool, Float, Point2f
from djpt.sensors.projective import Central

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Perspective"]

OFFSETS = ("principal_point_offset_x", "principal_point_offset_y")
REAL_LENS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "fx", "fy", "cx", "cy")
"""Entries of cameras whose lens distorts, or whose focal length is given in pixels."""


class Perspective(Central):
    """A pinhole camera: all rays through one point, the image plane upright.

    Parameters, besides those of all sensors: `fov` (degrees, in (0, 180), along `fov_axis`), or
    else `focal_length` (a string such as ``'50mm'``, the default, for 35 mm film); `fov_axis` (`x`,
    the default, `y`, `diagonal`, `smaller` or `larger` of the film's sides); `near_clip` (0.01) and
    `far_clip` (10000), measured along the optical axis; `principal_point_offset_x`, `_y` (0: shift
    of the image centre, in image widths and heights). `focus_distance` is accepted, without effect. With any of the
    entries of `djpt.sensors.distorted.DistortedPerspective`, numbers of a real lens, it is one of those; with `ior`,
    the index of what is around it, a `djpt.sensors.immersed.ImmersedPerspective`.

    The field of view refers to the whole film, also if only a crop of it is rendered. A ray starts
    on the near plane and ends on the far plane.
    """

    in_any_frame = True
    is_pinhole = True
    density_moves = True
    motions: ClassVar[tuple[str, ...]] = ("attached_matrix", "x_fov", *OFFSETS)

    def __new__(cls, props: Properties | None = None) -> Perspective:
        """The class itself, or one with a real lens or in a medium if `props` says so; copies have no `props`."""
        if cls is Perspective and props is not None and "ior" in props:
            from djpt.sensors.immersed import ImmersedPerspective

            return super().__new__(ImmersedPerspective)
        if cls is Perspective and props is not None and any(name in props for name in REAL_LENS):
            from djpt.sensors.distorted import DistortedPerspective  # most cameras need none of it

            return super().__new__(DistortedPerspective)
        return super().__new__(cls)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self._focus_distance = props.float("focus_distance", self._far_clip)
        self.principal_point_offset_x, self.principal_point_offset_y = map(Float, self.image_centre(props))
        self.place()

    def image_centre(self, props: Properties) -> tuple[float, float]:
        """The principal point's offsets, by the entries."""
        x, y = (props.float(name, 0.0) for name in OFFSETS)
        return x, y

    def traverse_lens(self, callback: TraversalCallback) -> None:
        for name in ("x_fov", *OFFSETS):
            callback.put(name, getattr(self, name), self.motion_flags(name))

    def move_lens(self, frame: Frame) -> None:
        self._focus_distance *= frame.scale

    def check_parameter(self, name: str, value: Any) -> Any:
        if name not in OFFSETS:
            return super().check_parameter(name, value)
        return Float(value) if dr.grad_enabled(value) else Float(as_number(value))

    def image_shift(self) -> NDArray[np.float64]:
        return np.array([float(dr.detach(getattr(self, name))[0]) for name in OFFSETS])

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        d = self.through_centre(film_position)
        length_squared = dr.squared_norm(d)
        inv_length = dr.rsqrt(length_squared)
        return Ray3f(dr.fma(d, self.near, self.origin), d * inv_length, maxt=self.depth * (length_squared * inv_length))


register_sensor("perspective", Perspective)
