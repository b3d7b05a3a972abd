"""Light from a point."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_array
from djpt.core.records import DirectionSample3f, EmissionSample, EmitterFlags, Observer, Ray3f
from djpt.core.warp import square_to_uniform_sphere
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import LARGEST, Properties
from djpt.description.registry import register_emitter
from djpt.emitters.base import DeltaEmitter, LightBounds, beam
from djpt.emitters.extent import mean_of
from djpt.errors import SceneError
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["PointLight", "towards_point"]

INV_FOUR_PI = 1 / (4 * math.pi)


class PointLight(DeltaEmitter):
    """Equal intensity in all directions: radiance falls off with 1 / dist^2.

    Parameters: `position` (or the translation of `to_world`, default origin), `intensity`
    (texture, W sr^-1, default 1, not negative).
    """

    values: ClassVar[Mapping[str, ParamFlags]] = {"position": ParamFlags.Differentiable | ParamFlags.Discontinuous}
    motions = ("position",)
    m_flags = int(EmitterFlags.DeltaPosition)
    children = ("intensity",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if "position" in props and "to_world" in props:
            raise SceneError(f"{props.node}: give 'position' or 'to_world', not both")
        self.motion = props.animation("to_world")
        if self.motion is not None:
            with props.naming("to_world"):
                self.motion.demand("rigid", "must not scale: an animated light has no size")
        if "position" in props:
            position = props.vector("position", (0, 0, 0))
        else:
            position = props.transform("to_world").matrix[:3, 3]
        self._given = np.array(position, np.float64)
        self.position: Any = Point3f(*(float(x) for x in position))
        self.intensity = props.texture("intensity", 1.0, low=0.0, high=LARGEST)
        if not self.intensity.is_constant:
            raise props.error("intensity", "can't vary: this light has no surface")

    def traverse(self, callback: TraversalCallback) -> None:
        super().traverse(callback)
        if self.motion is not None:
            callback.put("to_world", self.motion)

    def exact_position(self) -> NDArray[np.float64]:
        """The position (3,): in double precision as it was given, unless it has been edited."""
        now = as_array(dr.detach(self.position)).ravel()
        return self._given if np.array_equal(self._given.astype(np.float32), now) else now

    def move_into(self, frame: Frame) -> None:
        self.move_nested(frame)
        self.position = Point3f(*frame.point(self.exact_position()).tolist())
        self.intensity = frame.rescaled(self.intensity, 2)

    def power(self) -> float:
        return 4 * math.pi * mean_of(self.intensity)

    def bounds(self) -> LightBounds:
        at = as_array(dr.detach(self.position))
        return LightBounds(at, at, np.array([0.0, 0.0, 1.0]), math.pi, math.pi / 2, self.power())

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        ds, falloff = towards_point(self.position, it.p)
        return ds, self.intensity.eval(ds, active) * falloff

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        ray = Ray3f(self.position, square_to_uniform_sphere(direction_sample))
        weight = self.intensity.eval(ray, active) * (4 * math.pi)
        return beam(ray, weight, Float(1), Float(INV_FOUR_PI), finite=True, delta=True)

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        return Float(1), Float(INV_FOUR_PI)


def towards_point(position: Point3f, ref: Point3f) -> tuple[DirectionSample3f, Float]:
    """The direction from `ref` to a light at a point, the only one, and 1 / dist^2."""
    to_light = position - ref
    dist_squared = dr.squared_norm(to_light)
    inv_dist = dr.rsqrt(dist_squared)
    d = to_light * inv_dist
    ds = DirectionSample3f.of(
        position, -d, Point2f(0), d, dist_squared * inv_dist, Float(1), Float(1), Bool(True), UInt32(0)
    )
    return ds, dr.select(dist_squared > 0, dr.square(inv_dist), 0)


register_emitter("point", PointLight)
