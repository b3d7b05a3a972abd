"""Equal light from everywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import DirectionSample3f, EmissionSample, EmitterFlags, Observer, Ray3f, SurfaceInteraction3f
from djpt.core.warp import square_to_cosine_hemisphere, square_to_uniform_sphere
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import LARGEST, Properties
from djpt.description.registry import register_emitter
from djpt.emitters.base import InfiniteEmitter, beam
from djpt.emitters.extent import mean_of, number
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Vector3f

__all__ = ["ConstantBackground"]

INV_FOUR_PI = 1 / (4 * math.pi)


class ConstantBackground(InfiniteEmitter):
    """An environment of constant radiance, sampled uniformly over the sphere: pdf = 1 / (4 pi).

    Rays that leave it start at a uniform point of the sphere about the scene, of radius r, and go inwards with a
    density cos(theta) / pi about the normal there. This covers all lines through the sphere evenly, as do a uniform
    direction and a uniform point of the disk across it, by whose densities `sample_emission` describes the rays:

        1 / (4 pi r^2) dA cos(theta) / pi dw = 1 / (pi r^2) dA_across 1 / (4 pi) dw.

    Parameters: `radiance` (texture, W m^-2 sr^-1, default 1, not negative).
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(("center", "radius"), ParamFlags.NonDifferentiable)
    m_flags = int(EmitterFlags.Infinite)
    children = ("radiance",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.radiance = props.texture("radiance", 1.0, low=0.0, high=LARGEST)
        if not self.radiance.is_constant:
            raise props.error("radiance", "can't vary: this light has no surface")

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.share, attribute="share")
        callback.put("radiance", self.radiance)

    def power(self) -> float:
        return mean_of(self.radiance) * (2 * math.pi * number(self.radius)) ** 2

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.radiance.eval(si, active)

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        d = square_to_uniform_sphere(Point2f(sample))
        ds = self.towards(it, d, Point2f(0), Float(INV_FOUR_PI), Float(4 * math.pi))
        return ds, self.radiance.eval(ds, active) * (4 * math.pi)

    def pdf_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        return Float(INV_FOUR_PI)

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        outward = square_to_uniform_sphere(position_sample)
        d = Frame3f.from_normal(-outward).to_world(square_to_cosine_hemisphere(direction_sample))
        ray = Ray3f(dr.fma(outward, self.radius, self.center), d)
        position, direction = self.pdf_emission(d, d, Point2f(0))
        # The inverse of the densities' product.
        return beam(ray, self.radiance.eval(ray, active) * dr.square(2 * math.pi * self.radius), position, direction)

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        return dr.rcp(math.pi * dr.square(self.radius)), Float(INV_FOUR_PI)


register_emitter("constant", ConstantBackground)
