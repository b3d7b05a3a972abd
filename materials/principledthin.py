"""Disney's principled material for thin sheets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_bsdf
from djpt.jit.kernels import as_float, maximum
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.fresnel import fresnel, reflect, schlick
from djpt.materials.microfacet import MicrofacetDistribution
from djpt.materials.principled_lobes import (
    PrincipledBase,
    Scalars,
    alphas,
    diffuse,
    half_vector,
    inverse,
    schlick_r0,
    sheen,
    tint,
)

__all__ = ["PrincipledThin"]


@dataclass
class At:
    """The parameters at one surface point."""

    base_color: Color3f
    roughness: Float
    scalars: Scalars
    eta: Float
    clear: Any
    """The fraction of the light that meets the specular lobes."""
    passed: Any
    """The fraction of the diffuse light that is transmitted."""
    outside: MicrofacetDistribution | None
    """The microfacets that reflect."""
    through: MicrofacetDistribution | None
    """The microfacets that transmit: the roughness of both sides together."""


class PrincipledThin(PrincipledBase):
    """A sheet without thickness: diffuse and specular, reflecting and transmitting, the same from both sides.

    With t = `spec_trans`, p = `diff_trans` / 2, and wo mirrored to the side of wi for the half vector h,

        f = (1 - t) (1 - p) (base_color / pi + `sheen` (1 - o.h)^5)     retro-reflecting; `flatness`, `sheen_tint`
          + t F D G / (4 cos i cos o)
        f = (1 - t) p base_color / pi                                   transmitted
          + t base_color (1 - F) D' G' / (4 cos i cos o)

    D and G are GGX, D' and G' with the roughness times 0.65 eta - 0.35. F is Fresnel's reflectance, blended with
    Schlick's, tinted, by `spec_tint`. Light isn't bent.

    Parameters, all textures: `base_color` in [0, 1] (a colour, default 0.5); `roughness` in [0, 1]
    (default 0.5); `eta` > 0 (default 1.5); `spec_trans`, `anisotropic`, `spec_tint`, `sheen`, `sheen_tint`,
    `flatness` in [0, 1] and `diff_trans` in [0, 2] (default 0). Relative numbers of samples (>= 0, default 1):
    `specular_reflectance_sampling_rate`, `specular_transmittance_sampling_rate`,
    `diffuse_reflectance_sampling_rate`, `diffuse_transmittance_sampling_rate`.

    B. Burley 2015, section 5, see `djpt.materials.principled_lobes`. Lobes whose parameters are missing or 0
    are left out of the kernel.
    """

    in_any_frame = True
    optional = ("anisotropic", "diff_trans", "flatness", "sheen", "sheen_tint", "spec_tint", "spec_trans")
    values: ClassVar[Mapping[str, ParamFlags]] = {
        "specular_reflectance_sampling_rate": ParamFlags.NonDifferentiable,
        "specular_transmittance_sampling_rate": ParamFlags.NonDifferentiable,
        "diffuse_reflectance_sampling_rate": ParamFlags.NonDifferentiable,
        "diffuse_transmittance_sampling_rate": ParamFlags.NonDifferentiable,
    }
    allowed: ClassVar[Mapping[str, Allowed]] = dict.fromkeys(values, Allowed(0.0))
    children = ("base_color", "roughness", "eta", *optional)

    specular_reflectance_sampling_rate: Float
    specular_transmittance_sampling_rate: Float
    diffuse_reflectance_sampling_rate: Float
    diffuse_transmittance_sampling_rate: Float

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.base_color = props.texture("base_color", 0.5, low=0.0, high=1.0)
        self.roughness = props.texture_1("roughness", 0.5, low=0.0, high=1.0)
        self.eta = props.texture_1("eta", 1.5, low=0.0, low_open=True)
        self._read_optional(props, {"diff_trans": 2.0})
        for name in self.values:
            setattr(self, name, as_float(props.float(name, 1.0, low=0.0)))

    def components(self) -> tuple[int, ...]:
        both = BSDFFlags.FrontSide | BSDFFlags.BackSide
        skewed = BSDFFlags.Anisotropic if "anisotropic" in self.given else BSDFFlags.Empty
        lobes = [BSDFFlags.DiffuseReflection, BSDFFlags.DiffuseTransmission]
        if "spec_trans" in self.given:
            lobes.append(BSDFFlags.GlossyTransmission | skewed)
        return tuple(int(lobe | both) for lobe in (*lobes, BSDFFlags.GlossyReflection | skewed))

    def look_up(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> At:
        scalars = self._scalars(si, active)
        roughness, eta = self.roughness.eval_1(si, active), self.eta.eval_1(si, active)
        outside = through = None
        if "spec_trans" in scalars:
            anisotropic = scalars.get("anisotropic")
            outside = MicrofacetDistribution("ggx", *alphas(roughness, anisotropic))
            # Rays that cross both sides are bent twice, the more the larger eta is (Burley 2015, figure 15).
            scaled = roughness * dr.fma(eta, 0.65, -0.35)
            through = MicrofacetDistribution("ggx", *alphas(scaled, anisotropic))
        return At(
            base_color=self.base_color.eval(si, active),
            roughness=roughness,
            scalars=scalars,
            eta=eta,
            clear=scalars.get("spec_trans", 0),
            passed=0.5 * scalars.get("diff_trans", 0),
            outside=outside,
            through=through,
        )

    # ---- sampling --------------------------------------------------------------------------

    def _shares(self, at: At) -> tuple[Any, Any, Float, Any]:
        """The probabilities: specular reflection and transmission, diffuse reflection and transmission."""
        shares = (
            0.5 * at.clear * self.specular_reflectance_sampling_rate,
            0.5 * at.clear * self.specular_transmittance_sampling_rate,
            (1 - at.clear) * (1 - at.passed) * self.diffuse_reflectance_sampling_rate,
            (1 - at.clear) * at.passed * self.diffuse_transmittance_sampling_rate,
        )
        norm = inverse(sum(shares))
        a, b, c, d = (share * norm for share in shares)
        return a, b, c, d

    def draw(self, at: At, wi: Vector3f, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Bool]:
        mirror, glass, paint, _ = self._shares(at)

        def lobe(wo: Vector3f, sampled_type: BSDFFlags, component: int) -> BSDFSample3f:
            return BSDFSample3f.of(wo, 0, sampled_type, sampled_component=component)

        # From the last interval of `sample1` to the first.
        wo = square_to_cosine_hemisphere(sample2)
        bs, possible = lobe(wo, BSDFFlags.DiffuseReflection, 0), wo.z > 0
        if "diff_trans" in self.given:
            beyond = sample1 >= mirror + glass + paint
            bs = dr.select(beyond, lobe(-wo, BSDFFlags.DiffuseTransmission, 1), bs)
        if at.outside is not None and at.through is not None:
            m = at.through.sample_normal(wi, sample2)
            wo = reflect(wi, m)
            wo = Vector3f(wo.x, wo.y, -wo.z)
            passes = sample1 < mirror + glass
            bs = dr.select(passes, lobe(wo, BSDFFlags.GlossyTransmission, 2), bs)
            possible = dr.select(passes, (wo.z < 0) & (dr.dot(wo, m) < 0), possible)
            wo = reflect(wi, at.outside.sample_normal(wi, sample2))
            mirrors = sample1 < mirror
            bs = dr.select(mirrors, lobe(wo, BSDFFlags.GlossyReflection, 3), bs)
            possible = dr.select(mirrors, wo.z > 0, possible)
        return bs, possible

    # ---- evaluation ------------------------------------------------------------------------

    def eval_pdf_mirrored(self, at: At, ctx: BSDFContext, wi: Vector3f, wo: Vector3f) -> tuple[Color3f, Float]:
        mirror, glass, paint, back_light = self._shares(at)
        reflects, cos_o = wo.z > 0, dr.abs(wo.z)
        h, _ = half_vector(wi, Vector3f(wo.x, wo.y, cos_o))
        cos_d = maximum(dr.dot(wi, h), 1e-7)

        # Diffuse lobes.
        cosine_pdf = cos_o * (1 / math.pi)
        value = self._diffuse(at, wi.z, cos_o, cos_d)
        pdf = paint * cosine_pdf
        passed = at.base_color * ((1 - at.clear) * at.passed * cosine_pdf)
        passed_pdf = back_light * cosine_pdf
        if at.outside is not None and at.through is not None:
            F = fresnel(cos_d, at.eta)[0]
            color = self._specular_color(at, F, cos_d)
            f, f_pdf = self._specular(at.outside, wi, wo, h)
            value += at.clear * f * color
            pdf += mirror * f_pdf

            f, f_pdf = self._specular(at.through, wi, wo, h)
            # The direction itself, not its mirror image, must be behind the microfacet (as in Mitsuba).
            behind = dr.dot(wo, h) < 0
            passed += dr.select(behind, at.base_color * (at.clear * (1 - F) * f), 0)
            passed_pdf += dr.select(behind, glass * f_pdf, 0)
        return dr.select(reflects, value, passed), dr.select(reflects, pdf, passed_pdf)

    def _diffuse(self, at: At, cos_i: Float, cos_o: Float, cos_d: Float) -> Color3f:
        """The diffuse reflection and the sheen, times cos_o."""
        scalars, share = at.scalars, (1 - at.clear) * (1 - at.passed)
        f = diffuse(cos_i, cos_o, cos_d, at.roughness, scalars.get("flatness"))
        value = at.base_color * (share * f * (1 / math.pi))
        if "sheen" in scalars:
            value += sheen(at.base_color, cos_d, scalars["sheen"] * share, scalars.get("sheen_tint"))
        return value * cos_o

    @staticmethod
    def _specular(microfacets: MicrofacetDistribution, wi: Vector3f, wo: Vector3f, h: Vector3f) -> tuple[Float, Float]:
        """D G / (4 cos i), and the density of directions reflected at visible normals."""
        facing = 0.25 * microfacets.eval(h) * microfacets.smith_g1_over_cos(wi)
        return facing * microfacets.smith_g1_over_cos(wo) * dr.abs(wo.z), facing

    @staticmethod
    def _specular_color(at: At, F: Float, cos_d: Float) -> Color3f:
        """Fresnel's reflectance, blended with a tinted one."""
        if "spec_tint" not in at.scalars:
            return Color3f(F)
        cos_t = dr.abs(fresnel(cos_d, at.eta)[1])
        tinted = schlick(dr.select(at.eta > 1, cos_d, cos_t), tint(at.base_color) * schlick_r0(at.eta))
        return dr.lerp(Color3f(F), tinted, at.scalars["spec_tint"])


register_bsdf("principledthin", PrincipledThin)
