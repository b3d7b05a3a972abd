"""Lambertian reflection."""

from __future__ import annotations

import math

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDF

__all__ = ["Diffuse"]

INV_PI = 1 / math.pi


class Diffuse(BSDF):
    """f = reflectance / pi, on the side of the normal only; black from behind.

    Parameters: `reflectance` (texture in [0, 1], default 0.5). Sampled by the cosine:
    pdf = cos theta_o / pi, so the weight is the reflectance.
    """

    in_any_frame = True
    symmetric = True
    children = ("reflectance",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.reflectance = props.texture("reflectance", 0.5, low=0.0, high=1.0)

    def components(self) -> tuple[int, ...]:
        return (int(BSDFFlags.DiffuseReflection | BSDFFlags.FrontSide),)

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        if not self.is_asked(ctx):
            return BSDFSample3f.none(), Color3f(0)
        wo = square_to_cosine_hemisphere(sample2)
        # From behind, and at the horizon, the density vanishes and with it the sample.
        pdf = dr.select(si.wi.z > 0, wo.z * INV_PI, 0)
        weight = dr.select(pdf > 0, self.reflectance.eval(si, active), 0)
        return BSDFSample3f.of(wo, pdf, BSDFFlags.DiffuseReflection), weight

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        if not self.is_asked(ctx):
            return Color3f(0), Float(0)
        pdf = dr.select((si.wi.z > 0) & (wo.z > 0), wo.z * INV_PI, 0)
        return self.reflectance.eval(si, active) * pdf, pdf

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.reflectance.eval(si, active)


register_bsdf("diffuse", Diffuse)
