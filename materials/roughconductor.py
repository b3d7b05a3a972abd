"""Rough metal."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDFAtPoint
from djpt.materials.dielectric import optional_texture, tint
from djpt.materials.fresnel import fresnel_conductor, reflect
from djpt.materials.ior import metal
from djpt.materials.microfacet import ALPHAS, FacetsAtPoint, RoughBSDF

__all__ = ["RoughConductor"]


class RoughConductor(RoughBSDF):
    """f = F(wi, m) D(m) G(wi, wo, m) / (4 cos theta_i cos theta_o) with the half vector m; black from behind.

    F is the reflectance of a conductor of index eta + i k, D and G are those of
    `MicrofacetDistribution` (R. L. Cook and K. E. Torrance, TOG 1(1), 1982; Walter et al., EGSR 2007).

    Parameters:
        material: a name of `djpt.materials.ior.METALS` (default `none`: everything is reflected); or
        eta, k: the complex index (textures in [0, 1e6], defaults 0 and 1).
        distribution: of the microfacets, `beckmann` (default) or `ggx`.
        alpha: roughness (scalar texture in [0, 1], default 0.1; at least 1e-4 counts); or
        alpha_u, alpha_v: roughness along dp/du and dp/dv.
        sample_visible: sample only microfacets that are seen (default true).
        specular_reflectance: a factor (texture in [0, 1]; default: none), which real metals don't have.
    """

    in_any_frame = True
    symmetric = True
    children = ("specular_reflectance", *ALPHAS, "eta", "k")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.eta, self.k = metal(props)
        self.specular_reflectance = optional_texture(props, "specular_reflectance")

    def components(self) -> tuple[int, ...]:
        return (int(BSDFFlags.GlossyReflection | BSDFFlags.FrontSide | self.anisotropy),)

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return RoughConductorAtPoint(self, si, active)


class RoughConductorAtPoint(FacetsAtPoint):
    """A `RoughConductor` at one point, seen from `wi`: the work that evaluation and sampling share."""

    def __init__(self, bsdf: RoughConductor, si: SurfaceInteraction3f, active: Bool | bool) -> None:
        self.surface = bsdf.microfacets(si, active)
        self.eta, self.k = bsdf.eta.eval(si, active), bsdf.k.eval(si, active)
        self.tint = tint(bsdf.specular_reflectance, si, active)
        self.wi = si.wi
        self.g1_i = self.surface.smith_g1_over_cos(si.wi)

    def fresnel(self, cos: Float) -> Color3f:
        """The reflectance of a microfacet."""
        return fresnel_conductor(cos, self.eta, self.k) * self.tint

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        ok, cos, visible, pdf = self.facets(wo)
        value = self.fresnel(cos) * (visible * self.surface.smith_g1_over_cos(wo) * wo.z)
        return dr.select(ok, value, 0), dr.select(ok, pdf, 0)

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        m = self.surface.sample_normal(self.wi, sample2)
        cos = dr.dot(self.wi, m)
        wo = reflect(self.wi, m)
        d = self.surface.eval(m)
        ok = (self.wi.z > 0) & (cos > 0) & (wo.z > 0) & (d > 0)
        weight = self.surface.smith_g1_over_cos(wo) * wo.z
        if self.surface.sample_visible:
            pdf = 0.25 * d * self.g1_i
        else:
            pdf = d * m.z * 0.25 * dr.rcp(dr.select(ok, cos, 1))
            weight *= self.g1_i * cos * dr.rcp(dr.select(ok, m.z, 1))
        bs = BSDFSample3f.of(wo, dr.select(ok, pdf, 0), BSDFFlags.GlossyReflection)
        return bs, dr.select(ok, self.fresnel(cos) * weight, 0)


register_bsdf("roughconductor", RoughConductor)
