"""The orthographic camera."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.records import DirectionSample3f, Ray3f
from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.errors import SceneError
from djpt.jit.kernels import as_float, as_vector
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32
from djpt.sensors.projective import ProjectiveCamera

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Orthographic"]

MAX_SKEW = 1e-3
"""Largest cosine between axes that still counts as a right angle: transforms may come in float32."""


class Orthographic(ProjectiveCamera):
    """A camera whose rays are parallel: no perspective.

    It sees -1 <= x <= 1 of its space, -1 / aspect <= y <= 1 / aspect (aspect = width / height of the film), and
    looks along +z.

    Parameters, besides those of all sensors: `to_world` may scale: by (s, s, 1) for an image that is 2 s wide in
    the scene; `near_clip` (0.01) and `far_clip` (10000): rays start at the local z = near_clip and are
    far_clip - near_clip long. `focus_distance` is accepted, without effect.
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(
        ("corner", "across", "down", "direction", "depth", "to_column", "to_row", "inv_area"),
        ParamFlags.NonDifferentiable,
    )
    can_be_reached = True
    density_moves = True
    motions = ("attached_matrix",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self._focus_distance = props.float("focus_distance", self._far_clip)
        self.place()

    @staticmethod
    def check_placement(transform: ScalarTransform4f) -> None:
        axes = transform.matrix[:3, :3]
        axes = axes / np.linalg.norm(axes, axis=0)
        if np.abs(axes.T @ axes - np.eye(3)).max() > MAX_SKEW:
            raise SceneError("may scale along its own axes but must leave them at right angles, found a shear")

    def move_lens(self, frame: Frame) -> None:
        self._focus_distance *= frame.scale
        # Along the axis the near plane has been scaled already.
        self.to_world = self.to_world.scale([frame.scale, frame.scale, 1])

    def place(self) -> None:
        corner, step = self.crop_window(1.0)
        linear = self.to_world.matrix[:3, :3]
        self.corner = as_vector(self.to_world.translation() + linear @ [*corner, self._near_clip])
        self.across = as_vector(linear[:, 0] * step[0])
        self.down = as_vector(linear[:, 1] * step[1])
        self.direction = as_vector(linear[:, 2] / np.linalg.norm(linear[:, 2]))
        self.depth = as_float(self._far_clip - self._near_clip)
        across, down = linear[:, 0] * step[0], linear[:, 1] * step[1]
        self.to_column, self.to_row = as_vector(across / (across @ across)), as_vector(down / (down @ down))
        self.axis_length = float(np.linalg.norm(linear[:, 2]))
        self.inv_area = as_float(1 / float(np.linalg.norm(across) * np.linalg.norm(down)))

    def moved_rays(self, values: Mapping[str, Any]) -> dict[str, Any]:
        from djpt.sensors.moving import parallel_rays  # images of still cameras need none of it

        return parallel_rays(self, values)

    def projection_transform(self) -> Any:
        film = self.film()
        window = (film.size(), film.crop_size(), film.crop_offset())
        from djpt.sensors.projection_matrices import orthographic_projection  # the renderer needs no such matrix

        return orthographic_projection(*window, self._near_clip, self._far_clip)

    def near_clip_fraction(self) -> float:
        # A scale moves the near plane, as it does in Mitsuba, but not the length of rays.
        return super().near_clip_fraction() * self.axis_length

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        o = dr.fma(self.across, film_position.x, dr.fma(self.down, film_position.y, self.corner))
        return Ray3f(o, self.direction, maxt=self.depth)

    def sample_wi(
        self, ref: Point3f, aperture_sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Float]:
        to_ref = ref - self.corner
        z = dr.dot(to_ref, self.direction)
        uv = Point2f(dr.dot(to_ref, self.to_column), dr.dot(to_ref, self.to_row))
        seen = (z > 0) & (z < self.depth) & (uv.x >= 0) & (uv.x < 1) & (uv.y >= 0) & (uv.y < 1)
        ds = DirectionSample3f.of(
            p=dr.fma(self.direction, -z, ref),
            n=self.direction,
            uv=uv,
            d=-self.direction,
            dist=z,
            pdf=Float(1),
            weight=Float(1),
            delta=Bool(True),
            emitter_index=UInt32(0),
        )
        return ds, dr.select(seen, self.inv_area, 0)

    def pdf_ray(self, ray: Ray3f) -> tuple[Float, Float]:
        """1 / (area of the crop window), per unit area across the rays, and inf: they are parallel."""
        return self.inv_area, Float(dr.inf)


register_sensor("orthographic", Orthographic)
