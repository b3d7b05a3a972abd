"""Plastic as polarisation researchers model it: a diffuse base under rough facets, without light trapped between."""

from __future__ import annotations

import math

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.errors import SceneError
from djpt.jit.types import Bool, Color3f, Float, Vector3f
from djpt.materials.base import BSDFAtPoint
from djpt.materials.dielectric import optional_texture, tint
from djpt.materials.fresnel import fresnel
from djpt.materials.ior import ior
from djpt.materials.microfacet import ALPHAS, RoughBSDF, RoughCoatAtPoint
from djpt.textures.base import Texture

__all__ = ["PolarizedPlastic"]

INV_PI = 1 / math.pi


class PolarizedPlastic(RoughBSDF):
    """Light is reflected by rough facets, or refracted in, scattered once, and refracted out; black from behind.

    With F, D, G and m as for `RoughConductor`, but the F of a dielectric:

        f = F(wi, m) D G / (4 cos theta_i cos theta_o) + (1 - F(theta_i)) (1 - F(theta_o)) rho / pi.

    The model of S.-H. Baek, D. S. Jeon, X. Tong and M. H. Kim, "Simultaneous Acquisition of Polarimetric SVBRDF and
    Normals" (TOG 37(6), 2018), for light without polarisation.

    Parameters:
        diffuse_reflectance: rho (texture in [0, 1], default 0.5).
        specular_reflectance: a factor on the reflection of the facets (texture in [0, 1]; default: none).
        eta: relative index of refraction (scalar texture > 0); or
        int_ior, ext_ior: index of refraction within and around it (> 0, or a name of `djpt.materials.ior.IOR`;
            defaults `polypropylene`, `air`), which must differ.
        distribution: of the facets, `beckmann` (default) or `ggx`.
        alpha: roughness (scalar texture in [0, 1], default 0.1; at least 1e-4 counts); or
        alpha_u, alpha_v: roughness along dp/du and dp/dv.
        sample_visible: sample only facets that are seen (default true).
    """

    in_any_frame = True
    symmetric = True
    children = ("diffuse_reflectance", "eta", "specular_reflectance", *ALPHAS)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.diffuse_reflectance = props.texture("diffuse_reflectance", 0.5, low=0.0, high=1.0)
        self.specular_reflectance = optional_texture(props, "specular_reflectance")
        self.eta = relative_index(props)

    def components(self) -> tuple[int, ...]:
        facets, base = BSDFFlags.GlossyReflection | self.anisotropy, BSDFFlags.DiffuseReflection
        return int(facets | BSDFFlags.FrontSide), int(base | BSDFFlags.FrontSide)

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return PolarizedPlasticAtPoint(self, si, active, *self.asked(ctx))


class PolarizedPlasticAtPoint(RoughCoatAtPoint):
    """A `PolarizedPlastic` at one point, seen from `wi`: the work that evaluation and sampling share."""

    def __init__(
        self, bsdf: PolarizedPlastic, si: SurfaceInteraction3f, active: Bool | bool, shines: bool, scatters: bool
    ) -> None:
        """`shines` and `scatters`: whether each lobe is asked for."""
        self.shines, self.scatters, self.wi = shines, scatters, si.wi
        self.surface = bsdf.microfacets(si, active)
        self.g1_i = self.surface.smith_g1_over_cos(si.wi)
        self.eta = bsdf.eta.eval_1(si, active)
        self.tint = tint(bsdf.specular_reflectance, si, active)
        self.base = bsdf.diffuse_reflectance.eval(si, active) * ((1 - fresnel(si.wi.z, self.eta)[0]) * INV_PI)
        # Both lobes are drawn by their colours alone, from every direction.
        diffuse = bsdf.diffuse_reflectance.mean()
        specular = Float(1) if bsdf.specular_reflectance is None else bsdf.specular_reflectance.mean()
        total = specular + diffuse
        self.p_specular = dr.detach(specular * dr.rcp(dr.select(total > 0, total, 1)))
        if not (shines and scatters):
            self.p_specular = Float(shines)

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        ok, cos, visible, pdf = self.facets(wo)
        value = Color3f(0)
        if self.shines:
            value += self.tint * (fresnel(cos, self.eta)[0] * visible * self.surface.smith_g1_over_cos(wo) * wo.z)
        if self.scatters:
            value += self.base * ((1 - fresnel(wo.z, self.eta)[0]) * wo.z)
        pdf = dr.lerp(wo.z * INV_PI, pdf, self.p_specular)
        return dr.select(ok, value, 0), dr.select(ok, pdf, 0)


def relative_index(props: Properties) -> Texture:
    """The texture `eta`, or the constant quotient of `int_ior` and `ext_ior`."""
    if "eta" in props:
        if "int_ior" in props or "ext_ior" in props:
            raise props.error("eta", "can't be combined with 'int_ior' and 'ext_ior': give one or the others")
        return props.texture_1("eta", low=0.0, low_open=True)
    inner, outer = ior(props, "int_ior", "polypropylene"), ior(props, "ext_ior", "air")
    if inner == outer:
        raise SceneError(f"{props.node}: 'int_ior' must differ from 'ext_ior', found {inner:.9g} for both")
    return props.texture_1("eta", inner / outer, low=0.0, low_open=True)


register_bsdf("pplastic", PolarizedPlastic)
