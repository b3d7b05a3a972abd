"""Equal light from everywhere."""

from __future__ import annotations

import math

import drjit as dr

from djpt.description.properties import Properties
from djpt.emitters.base import Emitter
from djpt.records import DirectionSample3f, EmitterFlags, SurfaceInteraction3f
from djpt.types import Bool, Color3f, Float, Point2f, Point3f, UInt32
from djpt.warp import square_to_uniform_sphere

__all__ = ["ConstantBackground"]

INV_FOUR_PI = 1 / (4 * math.pi)


class ConstantBackground(Emitter):
    """An environment of constant radiance, sampled uniformly over the sphere: pdf = 1 / (4 pi).

    Parameters: `radiance` (texture, W m^-2 sr^-1, default 1, not negative).
    """

    children = ("radiance",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.radiance = props.texture("radiance", 1.0, low=0.0)
        if not self.radiance.is_constant:
            raise props.error("radiance", "can't vary: this light has no surface")

    def flags(self) -> int:
        return int(EmitterFlags.Infinite)

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.radiance.eval(si, active)

    def sample_direction(
        self, ref: Point3f, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        d = square_to_uniform_sphere(sample)
        ds = DirectionSample3f(
            # A stand-in for the point at infinity; visibility rays use `d` (see `Scene.shadow_ray`).
            ref + d,
            -d,
            Point2f(0),
            d,
            Float(dr.inf),
            Float(INV_FOUR_PI),
            Float(4 * math.pi),
            Bool(False),
            UInt32(0),
        )
        return ds, self.radiance.eval(ds, active) * (4 * math.pi)

    def pdf_direction(self, ref: Point3f, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        return Float(INV_FOUR_PI)
