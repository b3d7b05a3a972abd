"""Smooth plastic: a diffuse base under a clear coat."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32, Vector3f
from djpt.materials.base import BSDFAtPoint, SharedWorkBSDF
from djpt.materials.dielectric import optional_texture, tint
from djpt.materials.fresnel import fresnel, fresnel_diffuse_reflectance, reflect
from djpt.materials.ior import ETA, ior

__all__ = ["Plastic"]

INV_PI = 1 / math.pi


class Plastic(SharedWorkBSDF):
    """A mirror with the reflectance F(theta_i) of a dielectric over a diffuse base; black from behind.

    The base shines through the interface twice and light is trapped between both:

        f = (1 - F(theta_i)) (1 - F(theta_o)) / (pi eta^2) * rho / (1 - rho' F_int),

    where F_int is the interface's diffuse reflectance from within and rho' = 1, which keeps the colour
    of the base, or rho (`nonlinear`), which saturates it as real light does.

    Parameters:
        diffuse_reflectance: rho (texture in [0, 1], default 0.5).
        nonlinear: see above (default false).
        int_ior, ext_ior: index of refraction of the coat and around it (> 0, or a name of `djpt.materials.ior.IOR`;
            defaults `polypropylene`, `air`). As a parameter their quotient, `eta`.
        specular_reflectance: a factor on the mirror (texture in [0, 1]; default: none), which real coats don't have.
    """

    in_any_frame = True
    symmetric = True
    values: ClassVar[Mapping[str, ParamFlags]] = {"eta": ParamFlags.Differentiable}
    allowed = ETA
    children = ("diffuse_reflectance", "specular_reflectance")
    statics: ClassVar[tuple[str, ...]] = ("nonlinear",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.eta = as_float(ior(props, "int_ior", "polypropylene") / ior(props, "ext_ior", "air"))
        self.diffuse_reflectance = props.texture("diffuse_reflectance", 0.5, low=0.0, high=1.0)
        self.specular_reflectance = optional_texture(props, "specular_reflectance")
        self.nonlinear = props.boolean("nonlinear", False)

    def components(self) -> tuple[int, ...]:
        mirror, base = BSDFFlags.DeltaReflection, BSDFFlags.DiffuseReflection
        return int(mirror | BSDFFlags.FrontSide), int(base | BSDFFlags.FrontSide)

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return PlasticAtPoint(self, si, active, *self.asked(ctx))

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.diffuse_reflectance.eval(si, active)


class PlasticAtPoint:
    """A `Plastic` at one point, seen from `wi`: the work that evaluation and sampling share."""

    def __init__(
        self, bsdf: Plastic, si: SurfaceInteraction3f, active: Bool | bool, mirrors: bool = True, scatters: bool = True
    ) -> None:
        """`mirrors` and `scatters`: whether each lobe is asked for."""
        self.scatters = scatters
        self.eta, self.wi = bsdf.eta, si.wi
        self.tint = tint(bsdf.specular_reflectance, si, active)
        self.reflected = fresnel(si.wi.z, bsdf.eta)[0]
        inv_eta = dr.rcp(bsdf.eta)
        trapped = fresnel_diffuse_reflectance(inv_eta)
        base = bsdf.diffuse_reflectance.eval(si, active)
        returned = dr.rcp(1 - base * trapped) if bsdf.nonlinear else dr.rcp(1 - trapped)
        self.base = base * (returned * dr.square(inv_eta) * (1 - self.reflected))
        """The base's f cos theta_o, without the factor (1 - F(theta_o)) cos theta_o / pi."""
        # The mirror and the base are drawn by how much they reflect on average.
        diffuse = bsdf.diffuse_reflectance.mean()
        specular = 1 if bsdf.specular_reflectance is None else bsdf.specular_reflectance.mean()
        mirror, through = self.reflected * specular, (1 - self.reflected) * diffuse
        total = mirror + through
        self.p_specular = dr.detach(mirror * dr.rcp(dr.select(total > 0, total, 1)))
        if not (mirrors and scatters):
            self.p_specular = Float(mirrors)

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        if not self.scatters:
            return Color3f(0), Float(0)
        ok = (self.wi.z > 0) & (wo.z > 0)
        cosine = dr.select(ok, wo.z * INV_PI, 0)
        value = self.base * ((1 - fresnel(wo.z, self.eta)[0]) * cosine)
        return value, (1 - self.p_specular) * cosine

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        specular = sample1 < self.p_specular
        diffuse_wo = square_to_cosine_hemisphere(sample2)
        p_diffuse = 1 - self.p_specular
        wo = dr.select(specular, reflect(self.wi), diffuse_wo)
        pdf = dr.select(specular, self.p_specular, p_diffuse * INV_PI * diffuse_wo.z)
        ok = (self.wi.z > 0) & (pdf > 0)
        inv_p = dr.rcp(dr.select(ok, dr.select(specular, self.p_specular, p_diffuse), 1))
        mirror = self.tint * self.reflected
        base = self.base * (1 - fresnel(diffuse_wo.z, self.eta)[0])
        weight = dr.select(specular, mirror, base) * inv_p
        sampled_type = dr.select(specular, UInt32(BSDFFlags.DeltaReflection), UInt32(BSDFFlags.DiffuseReflection))
        component = dr.select(specular, UInt32(0), UInt32(1))
        bs = BSDFSample3f.of(wo, dr.select(ok, pdf, 0), sampled_type, sampled_component=component)
        return bs, dr.select(ok, weight, 0)


register_bsdf("plastic", Plastic)
