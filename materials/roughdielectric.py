"""Rough glass."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import ClassVar

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, TransportMode
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32, Vector3f
from djpt.materials.base import BSDFAtPoint, derivative_of_choice
from djpt.materials.dielectric import optional_texture, tint
from djpt.materials.fresnel import fresnel, reflect, refract
from djpt.materials.ior import ETA, ior
from djpt.materials.microfacet import ALPHAS, RoughBSDF

__all__ = ["RoughDielectric"]


class RoughDielectric(RoughBSDF):
    """Reflection and refraction by microfacets with Fresnel reflectance F, from both sides.

    With i = abs(dot(wi, m)), o = abs(dot(wo, m)), D and G of `MicrofacetDistribution` and the index eta
    of the far side relative to the near one:

        f_r = F D G / (4 abs(cos theta_i cos theta_o)),                       m along wi + wo,
        f_t = (1 - F) D G i o / (abs(cos theta_i cos theta_o) dot(h, h)),     m along h = wi + eta wo.

    f_t is for radiance, which is denser by eta^2 behind the interface; importance gets eta^2 f_t. (B. Walter, S.
    Marschner, H. Li, K. Torrance, "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, equations 20
    and 21.)

    Parameters:
        int_ior, ext_ior: index of refraction behind and in front of the surface (> 0, or a name of
            `djpt.materials.ior.IOR`; defaults `bk7`, `air`), which must differ. As a parameter their quotient, `eta`.
        distribution: of the microfacets, `beckmann` (default) or `ggx`.
        alpha: roughness (scalar texture in [0, 1], default 0.1; at least 1e-4 counts); or
        alpha_u, alpha_v: roughness along dp/du and dp/dv.
        sample_visible: sample only microfacets that are seen (default true); otherwise all of a slightly rougher
            surface, which bounds the weights (Walter et al., section 5.3).
        specular_reflectance, specular_transmittance: factors for the two lobes (textures in [0, 1]; default: none),
            which real glass doesn't have.
    """

    in_any_frame = True
    symmetric = True
    bounds_bodies = True
    values: ClassVar[Mapping[str, ParamFlags]] = {"eta": ParamFlags.Differentiable | ParamFlags.Discontinuous}
    allowed = ETA
    children = (*ALPHAS, "specular_reflectance", "specular_transmittance")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        int_ior, ext_ior = ior(props, "int_ior", "bk7"), ior(props, "ext_ior", "air")
        if int_ior == ext_ior:
            raise props.error(
                "int_ior", f"must differ from 'ext_ior', found {int_ior:.9g} for both: the surface would be invisible"
            )
        self.eta = as_float(int_ior / ext_ior)
        self.specular_reflectance = optional_texture(props, "specular_reflectance")
        self.specular_transmittance = optional_texture(props, "specular_transmittance")

    def surrounded_by(self, index: Float) -> RoughDielectric:
        view = copy.copy(self)
        view.eta = self.eta / index
        return view

    def components(self) -> tuple[int, ...]:
        common = BSDFFlags.FrontSide | BSDFFlags.BackSide | self.anisotropy
        return (
            int(BSDFFlags.GlossyReflection | common),
            int(BSDFFlags.GlossyTransmission | BSDFFlags.NonSymmetric | common),
        )

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return RoughDielectricAtPoint(self, ctx, si, active, *self.asked(ctx))


class RoughDielectricAtPoint:
    """A `RoughDielectric` at one point, seen from `wi`: the work that evaluation and sampling share."""

    def __init__(
        self,
        bsdf: RoughDielectric,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        active: Bool | bool,
        reflects: bool = True,
        transmits: bool = True,
    ) -> None:
        """`reflects` and `transmits`: whether each lobe is asked for."""
        self.reflects, self.both = reflects, reflects and transmits
        self.surface = bsdf.microfacets(si, active)
        self.sampled = self.surface
        if not bsdf.sample_visible:
            self.sampled = self.surface.scaled(1.2 - 0.2 * dr.sqrt(dr.abs(dr.detach(si.wi.z))))
        self.radiance = ctx.mode == TransportMode.Radiance
        self.wi, self.eta = si.wi, bsdf.eta
        self.eta_it = dr.select(si.wi.z > 0, bsdf.eta, dr.rcp(bsdf.eta))
        self.g1_i = self.surface.smith_g1_over_cos(si.wi)
        self.tint_r = tint(bsdf.specular_reflectance, si, active)
        self.tint_t = tint(bsdf.specular_transmittance, si, active)

    def density(self, m: Vector3f, d: Float, cos: Float) -> Float:
        """The density of sampling the microfacet `m`, where D is `d` and `cos` is dot(wi, m)."""
        return d * self.g1_i * dr.abs(cos) if self.surface.sample_visible else self.sampled.eval(m) * m.z

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        reflected = self.wi.z * wo.z > 0
        # The microfacet that reflects or refracts, on the side of the surface's normal.
        h = dr.fma(wo, dr.select(reflected, 1, self.eta_it), self.wi)
        h2 = dr.squared_norm(h)
        inv_h2 = dr.rcp(dr.select(h2 > 1e-12, h2, 1e-12))
        m = h * dr.mulsign(dr.sqrt(inv_h2), h.z)
        cos_i, cos_o = dr.dot(self.wi, m), dr.dot(wo, m)
        ok = (cos_i * self.wi.z > 0) & (cos_o * wo.z > 0)
        if not self.both:
            ok &= reflected if self.reflects else ~reflected

        d = self.surface.eval(m)
        f = fresnel(cos_i, self.eta)[0]
        # The length of h, abs(cos_i + eta_it cos_o), turns densities of h into densities of wo.
        passed = dr.abs(cos_o) * inv_h2
        passed_pdf = passed * dr.square(self.eta_it)
        value = d * self.g1_i * self.surface.smith_g1_over_cos(wo) * dr.abs(wo.z)
        transmitted = value * (1 - f) * dr.abs(cos_i) * (passed if self.radiance else passed_pdf)
        result = dr.select(reflected, self.tint_r * (0.25 * value * f), self.tint_t * transmitted)
        chance_r, chance_t = (f, 1 - f) if self.both else (Float(1), Float(1))
        per_wo = dr.select(reflected, chance_r * 0.25 * dr.rcp(dr.select(ok, dr.abs(cos_o), 1)), chance_t * passed_pdf)
        return dr.select(ok, result, 0), dr.select(ok, self.density(m, d, cos_i) * per_wo, 0)

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        m = self.sampled.sample_normal(dr.mulsign(self.wi, self.wi.z), sample2)
        cos_i = dr.dot(self.wi, m)
        f, cos_t, eta_it, eta_ti = fresnel(cos_i, self.eta)
        reflected = sample1 <= f if self.both else Bool(self.reflects)
        chance_r, chance_t = (f, 1 - f) if self.both else (Float(1), Float(1))
        wo = dr.select(reflected, reflect(self.wi, m), refract(self.wi, m, cos_t, eta_ti))
        cos_o = dr.select(reflected, cos_i, cos_t)

        d = self.surface.eval(m)
        density = self.density(m, d, cos_i)
        ok = (cos_i * self.wi.z > 0) & (cos_o * wo.z > 0) & (density > 0)
        denominator = dr.select(reflected, 4 * dr.abs(cos_i), dr.square(dr.fma(eta_it, cos_t, cos_i)))
        numerator = dr.select(reflected, chance_r, chance_t * dr.square(eta_it) * dr.abs(cos_t))
        pdf = density * numerator * dr.rcp(dr.select(ok & (denominator > 0), denominator, 1))

        g = self.surface.smith_g1_over_cos(wo) * dr.abs(wo.z)
        if not self.surface.sample_visible:
            # Mitsuba 3.9.1 leaves out that the facets were drawn from a rougher surface: it is up to 14 % brighter.
            g *= d * self.g1_i * dr.abs(cos_i) * dr.rcp(dr.select(ok, density, 1))
        through = self.tint_t * dr.square(eta_ti) if self.radiance else self.tint_t
        weight = dr.select(reflected, self.tint_r, through) * g
        share = dr.select(reflected, f, 1 - f)
        weight = weight * (derivative_of_choice(share) if self.both else share)
        sampled_type = dr.select(reflected, UInt32(BSDFFlags.GlossyReflection), UInt32(BSDFFlags.GlossyTransmission))
        eta = dr.select(reflected, 1, eta_it)
        component = dr.select(reflected, UInt32(0), UInt32(1))
        bs = BSDFSample3f.of(wo, dr.select(ok, pdf, 0), sampled_type, eta=eta, sampled_component=component)
        return bs, dr.select(ok, weight, 0)


register_bsdf("roughdielectric", RoughDielectric)
