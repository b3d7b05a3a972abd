"""Parallel light from infinitely far away."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.frame import coordinate_system
from djpt.core.records import DirectionSample3f, EmissionSample, EmitterFlags, Observer, Ray3f
from djpt.core.transforms import ScalarTransform4f
from djpt.core.warp import square_to_uniform_disk_concentric
from djpt.description.plugin import ParamFlags
from djpt.description.properties import LARGEST, Properties
from djpt.description.registry import register_emitter
from djpt.emitters.base import DeltaEmitter, InfiniteEmitter, beam
from djpt.emitters.extent import mean_of, number
from djpt.emitters.oriented import OrientedEmitter
from djpt.errors import SceneError
from djpt.jit.kernels import as_vector
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, UInt32, Vector3f

__all__ = ["DirectionalEmitter"]


class DirectionalEmitter(DeltaEmitter, InfiniteEmitter, OrientedEmitter):
    """Light that travels in one direction everywhere; a plane across it receives `irradiance`.

    Parameters: `irradiance` (texture, W m^-2, default 1, not negative, can't vary), and `direction` (in which the
    light travels; any length but 0) or `to_world` (the light travels along its +z axis; default identity).
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = {
        **OrientedEmitter.values,
        **dict.fromkeys(("center", "radius"), ParamFlags.NonDifferentiable),
    }
    m_flags = int(EmitterFlags.Infinite | EmitterFlags.DeltaDirection)
    children = ("irradiance",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        if "direction" in props:
            if "to_world" in props:
                raise SceneError(f"{props.node}: give 'direction' or 'to_world', not both")
            direction = props.vector("direction")
            if not direction.any():
                raise props.error("direction", "must not be zero")
            self.to_world = looking_along(direction)
            self._place()
        self.irradiance = props.texture("irradiance", 1.0, low=0.0, high=LARGEST)
        if not self.irradiance.is_constant:
            raise props.error("irradiance", "can't vary: this light has no surface")

    # ---- on the host -------------------------------------------------------------------

    def power(self) -> float:
        return math.pi * number(self.radius) ** 2 * mean_of(self.irradiance)

    # ---- in kernels --------------------------------------------------------------------

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        ds = DirectionSample3f.of(
            # A stand-in for the point at infinity; visibility rays use `d` (see `Scene.shadow_ray`).
            it.p - self.forward,
            self.forward,
            Point2f(0),
            -self.forward,
            Float(dr.inf),
            Float(1),
            Float(1),
            Bool(True),
            UInt32(0),
        )
        return ds, self.irradiance.eval(ds, active)

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        # From a disk as wide as the scene, in front of it.
        at = square_to_uniform_disk_concentric(position_sample)
        o = dr.fma(self.local_to_world(Vector3f(at.x, at.y, -1)), self.radius, self.center)
        ray = Ray3f(o, Vector3f(self.forward))
        area = math.pi * dr.square(self.radius)
        return beam(ray, self.irradiance.eval(ray, active) * area, dr.rcp(area), Float(1), delta=True)

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        return dr.rcp(math.pi * dr.square(self.radius)), Float(1)


def looking_along(direction: NDArray[np.float64]) -> ScalarTransform4f:
    """A rotation that takes +z to a direction, the other axes as in Mitsuba."""
    unit = direction / np.linalg.norm(direction)
    up = coordinate_system(as_vector(unit))[0]
    return ScalarTransform4f().look_at(origin=[0, 0, 0], target=unit, up=up)


register_emitter("directional", DirectionalEmitter)
