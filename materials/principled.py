"""Disney's principled material for closed bodies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, TransportMode
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_bsdf
from djpt.jit.kernels import as_float, maximum
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.fresnel import fresnel, reflect, refract, schlick
from djpt.materials.ior import ETA
from djpt.materials.microfacet import MicrofacetDistribution
from djpt.materials.principled_lobes import (
    GTR1,
    PrincipledBase,
    Scalars,
    alphas,
    diffuse,
    half_vector,
    inverse,
    schlick_r0,
    sheen,
    smith_g1,
    square_root,
    tint,
)

__all__ = ["Principled"]

COAT_R0 = 0.04
"""Reflectance of the clear coat at normal incidence: an index of 1.5."""

COAT_SHADOWING = 0.25
"""Roughness of the clear coat, as far as its shadowing is concerned."""


BELOW = (
    "isn't a parameter: light that comes out elsewhere needs a medium inside the shape, such as a 'homogeneous' one "
    "with 'color' and 'radius'; djpt.subsurface(base_color, radius, weight=0.5) gives the 'bsdf' and the 'interior'"
)
"""The message about parameters of subsurface scattering that other renderers have in this material."""

SUBSURFACE = ("subsurface", "subsurface_color")
"""The parameters of subsurface scattering that there are."""


@dataclass
class At:
    """The parameters at one surface point, seen from `wi`."""

    base_color: Color3f
    roughness: Float
    scalars: Scalars
    coat: GTR1 | None
    eta: Float
    """Index behind the surface over the one in front of it, as the incident ray sees it."""
    front: Bool
    """True where the ray arrives from outside."""
    opaque: Any
    """The fraction of the light that meets the diffuse lobe."""
    clear: Any
    """The fraction of the light that isn't reflected by the interface, and passes through it."""
    inside: Any
    """The fraction of the interface's reflection that is seen from inside."""
    passed: Color3f | None
    """The filter that light passes through on its way in or out; None if all is opaque."""
    microfacets: MicrofacetDistribution


class Principled(PrincipledBase):
    """A blend of a diffuse surface, metal, and rough glass, under sheen and a clear coat.

    With m = `metallic`, t = `spec_trans` and the half vector h,

        f = (1 - m) (1 - t) base_color / pi               diffuse, retro-reflecting; `flatness`: flat subsurface
          + (1 - m) `sheen` (1 - o.h)^5                   white, or the hue of base_color by `sheen_tint`
          + F D G / (4 cos i cos o)                       GGX; F: Schlick's for metal and `spec_tint`, else Fresnel's
          + (1 - m) t sqrt(base_color) (1 - F) D G abs(i.h o.h) / (cos i cos o (i.h + eta o.h)^2)      refracted
          + `clearcoat` / 4 F_c D_c G_c                   GTR1, smoother by `clearcoat_gloss`

    for radiance. From inside (from behind), only Fresnel's reflection and the refraction are seen, so that
    without `spec_trans` the material is black there.

    With `subsurface` s in place of t, the filter is sqrt(base_color / subsurface_color), and what is refracted has the
    factor (1 - m) s on the way of a camera's path into the body, and 1 on its way out.

    Parameters, all textures in [0, 1] that default to 0 unless said otherwise:

    * `base_color` (a colour, default 0.5), `roughness` (default 0.5), `metallic`, `spec_trans`,
      `anisotropic`, `spec_tint`, `sheen`, `sheen_tint`, `flatness`, `clearcoat`, `clearcoat_gloss`;
    * `subsurface`, not together with `spec_trans`: the fraction of the diffuse light that enters the body and leaves it
      after a random walk through the `interior` of the shape, a medium that gives large bodies the colour
      `subsurface_color` (default 1): `djpt.subsurface` makes both;
    * `eta` > 0: the relative index of refraction, **or** `specular` in [0, 1] (default 0.5):
      eta = 2 / (1 - sqrt(0.08 specular)) - 1;
    * `main_specular_sampling_rate`, `clearcoat_sampling_rate`, `diffuse_reflectance_sampling_rate`
      (>= 0, default 1): relative numbers of samples.

    eta - 1 grows like sqrt(0.32 specular). So the angle by which light is refracted has an infinite slope by
    `specular` at 0: with `spec_trans`, derivatives below 0.001 are those at 0.001. The reflectance, of second order in
    eta - 1, has a slope at 0: 0.08 at normal incidence, more at grazing angles, where it takes many samples. At
    exactly 0 there is no interface, and no metal either (as in Mitsuba): a jump that derivatives don't see.

    The weight of `subsurface` is that of the place where a camera's path enters, as in Blender: light that comes from
    inside leaves everywhere alike. So the image of a convex body under a sky is the mixture, by a uniform weight, of
    those of the weights 0 and 1, and a white body stays white, whatever texture the weight is. (Light that were kept
    inside by the opaque part would make longer walks.) Where the weight varies, f isn't reciprocal; light paths
    have the adjoint.

    B. Burley 2012 and 2015, see `djpt.materials.principled_lobes`; as Mitsuba has it, without volumes. Lobes
    whose parameters are missing or 0 are left out of the kernel.
    """

    in_any_frame = True
    symmetric = True
    optional = (
        "anisotropic",
        "clearcoat",
        "flatness",
        "metallic",
        "sheen",
        "sheen_tint",
        "spec_tint",
        "spec_trans",
        "subsurface",
    )
    values: ClassVar[Mapping[str, ParamFlags]] = {
        "interface": ParamFlags.Differentiable | ParamFlags.Discontinuous,
        "main_specular_sampling_rate": ParamFlags.NonDifferentiable,
        "clearcoat_sampling_rate": ParamFlags.NonDifferentiable,
        "diffuse_reflectance_sampling_rate": ParamFlags.NonDifferentiable,
    }
    allowed: ClassVar[Mapping[str, Allowed]] = {
        **dict.fromkeys(values, Allowed(0.0)),
        "specular": Allowed(0.0, 1.0),
        **ETA,
    }
    children = ("base_color", "roughness", "clearcoat_gloss", "subsurface_color", *optional)
    statics = ("given", "by_specular")

    main_specular_sampling_rate: Float
    clearcoat_sampling_rate: Float
    diffuse_reflectance_sampling_rate: Float

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        for key in props:
            if key.startswith("subsurface") and key not in SUBSURFACE:
                raise props.error(key, BELOW)
        self.base_color = props.texture("base_color", 0.5, low=0.0, high=1.0)
        self.roughness = props.texture_1("roughness", 0.5, low=0.0, high=1.0)
        self.clearcoat_gloss = props.texture_1("clearcoat_gloss", 0.0, low=0.0, high=1.0)
        self.has_subsurface = "subsurface" in props
        if self.has_subsurface and "spec_trans" in props:
            raise props.error("subsurface", "and 'spec_trans' can't be combined: what is inside is one medium")
        if "subsurface_color" in props and not self.has_subsurface:
            raise props.error("subsurface_color", "belongs to 'subsurface', the weight of subsurface scattering")
        self.subsurface_color = props.texture("subsurface_color", 1.0, low=0.0, high=1.0)
        self._read_optional(props)
        if "eta" in props and "specular" in props:
            raise props.error("eta", "and 'specular' set the same property: give only one")
        self.by_specular = "eta" not in props
        number = props.float("specular", 0.5, low=0.0, high=1.0) if self.by_specular else 0.0
        self.interface = as_float(number if self.by_specular else props.float("eta", low=0.0, low_open=True))
        for name in self.values:
            if name != "interface":
                setattr(self, name, as_float(props.float(name, 1.0, low=0.0)))

    def traverse(self, callback: TraversalCallback) -> None:
        for name, flags in self.values.items():
            reported = ("specular" if self.by_specular else "eta") if name == "interface" else name
            callback.put(reported, getattr(self, name), flags, attribute=name)
        for name in self.children:
            if self.has_subsurface or name not in SUBSURFACE:
                callback.put(name, getattr(self, name))

    @property
    def needs_interior(self) -> bool:
        return self.has_subsurface

    @property
    def transmits(self) -> bool:
        """Whether light enters the body."""
        return not self.given.isdisjoint(("spec_trans", "subsurface"))

    def components(self) -> tuple[int, ...]:
        both = BSDFFlags.FrontSide | BSDFFlags.BackSide
        skewed = BSDFFlags.Anisotropic if "anisotropic" in self.given else BSDFFlags.Empty
        lobes = [BSDFFlags.DiffuseReflection | BSDFFlags.FrontSide]
        if "clearcoat" in self.given:
            lobes.append(BSDFFlags.GlossyReflection | BSDFFlags.FrontSide)
        if self.transmits:
            lobes.append(BSDFFlags.GlossyTransmission | BSDFFlags.NonSymmetric | skewed | both)
        return tuple(int(lobe) for lobe in (*lobes, BSDFFlags.GlossyReflection | skewed | both))

    # ---- parameters ------------------------------------------------------------------------

    def _eta(self) -> Float:
        """The relative index of refraction; moved off 1 a little if light is refracted, which needs an interface."""
        if not self.by_specular:
            return dr.select(self.interface == 1, 1.001, self.interface) if self.transmits else self.interface
        specular = self.interface
        if self.transmits:
            # Slopes below are those of the smallest interface: closer to 1 refracted light comes in ever thinner lobes.
            if dr.grad_enabled(specular):
                specular = specular + maximum(1e-3 - dr.detach(specular), Float(0))
            else:
                specular = dr.select(specular == 0, 1e-3, specular)
        return 2 * dr.rcp(1 - square_root(0.08 * specular)) - 1

    def look_up(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> At:
        scalars = self._scalars(si, active)
        front = si.wi.z > 0
        eta, coat = self._eta(), None
        not_metal = 1 - scalars.get("metallic", 0)
        entered: Any = scalars.get("subsurface", scalars.get("spec_trans", 0))
        clear = inside = not_metal * entered
        base_color, passed = self.base_color.eval(si, active), None
        if "subsurface" in scalars:
            camera_enters = front if ctx.mode == TransportMode.Radiance else ~front
            clear, inside = dr.select(camera_enters, clear, 1), 1
            body = self.subsurface_color.eval(si, active)
            passed = square_root(base_color * dr.rcp(dr.select(body > 1e-30, body, 1)))
        elif "spec_trans" in scalars:
            passed = square_root(base_color)
        if passed is not None:
            eta = dr.select(front, eta, dr.rcp(eta))
        if "clearcoat" in scalars:
            # Glossy coats are smooth ones: their roughness runs from 0.1 down to 0.001.
            coat = GTR1(dr.lerp(Float(0.1), Float(0.001), self.clearcoat_gloss.eval_1(si, active)))
        roughness = self.roughness.eval_1(si, active)
        return At(
            base_color=base_color,
            roughness=roughness,
            scalars=scalars,
            coat=coat,
            eta=eta,
            front=front,
            opaque=not_metal * (1 - entered),
            clear=clear,
            inside=inside,
            passed=passed,
            microfacets=MicrofacetDistribution("ggx", *alphas(roughness, scalars.get("anisotropic"))),
        )

    def is_seen(self, at: At) -> Bool:
        return at.front if at.passed is None else at.front | (at.inside > 0)

    # ---- sampling --------------------------------------------------------------------------

    def _shares(self, at: At) -> tuple[Float, Any, Float]:
        """The probabilities of the diffuse lobe, the coat and the specular lobes: the last alone, seen from inside."""
        specular = self.main_specular_sampling_rate
        body = at.opaque * self.diffuse_reflectance_sampling_rate
        coat = 0.25 * at.scalars.get("clearcoat", 0) * self.clearcoat_sampling_rate
        norm = inverse(body + coat + specular)
        body, coat, specular = body * norm, coat * norm, specular * norm
        if at.passed is not None:
            body, coat = dr.select(at.front, body, 0), dr.select(at.front, coat, 0)
            specular = dr.select(at.front, specular, 1)
        return body, coat, specular

    def draw(self, at: At, wi: Vector3f, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Bool]:
        body, coat, specular = self._shares(at)
        m = at.microfacets.sample_normal(wi, sample2)
        wo = reflect(wi, m)
        bs = BSDFSample3f.of(wo, 0, BSDFFlags.GlossyReflection, sampled_component=3)
        possible = wo.z > 0
        if at.passed is not None:
            reflectance, cos_theta_t, _, eta_ti = fresnel(dr.dot(wi, m), at.eta)
            refracts = sample1 < body + coat + specular * dr.select(at.front, at.clear, 1) * (1 - reflectance)
            wo = refract(wi, m, cos_theta_t, eta_ti)
            possible = dr.select(refracts, (wo.z < 0) & (dr.dot(wo, m) < 0), possible)
            bs_t = BSDFSample3f.of(wo, 0, BSDFFlags.GlossyTransmission, eta=at.eta, sampled_component=2)
            bs = dr.select(refracts, bs_t, bs)
        if at.coat is not None:
            m = at.coat.sample(sample2)
            wo = reflect(wi, m)
            coated = sample1 < body + coat
            possible = dr.select(coated, (wo.z > 0) & (dr.dot(wi, m) > 0), possible)
            bs_c = BSDFSample3f.of(wo, 0, BSDFFlags.GlossyReflection, sampled_component=1)
            bs = dr.select(coated, bs_c, bs)
        wo = square_to_cosine_hemisphere(sample2)
        scattered = sample1 < body
        possible = dr.select(scattered, wo.z > 0, possible)
        return dr.select(scattered, BSDFSample3f.of(wo, 0, BSDFFlags.DiffuseReflection), bs), possible

    # ---- evaluation ------------------------------------------------------------------------

    def eval_pdf_mirrored(self, at: At, ctx: BSDFContext, wi: Vector3f, wo: Vector3f) -> tuple[Color3f, Float]:
        scalars, transmits = at.scalars, at.passed is not None
        reflects = wo.z > 0
        h, length_squared = half_vector(wi, wo * dr.select(reflects, 1, at.eta) if transmits else wo)
        i_h, o_h = dr.dot(wi, h), dr.dot(wo, h)
        cos_o = dr.abs(wo.z)
        # Microfacets that face away from `wi` count for nothing; the bound keeps derivatives finite there.
        cos_d = maximum(i_h, 1e-7)
        F, cos_theta_t, _, _ = fresnel(cos_d, at.eta)
        facing = at.microfacets.eval(h) * at.microfacets.smith_g1_over_cos(wi)  # D G1(wi) / cos i
        body, coat, specular = self._shares(at)

        # Main specular lobe. For reflection dot(wi, h) = dot(wo, h).
        jacobian = 0.25 * dr.rcp(cos_d)
        shadowed = facing * at.microfacets.smith_g1_over_cos(wo) * cos_o
        schlick_cos = dr.select(at.eta > 1, cos_d, dr.abs(cos_theta_t))
        # An interface that reflects nothing is no interface, for metals as well (as in Mitsuba).
        value = dr.select(F > 0, self._specular_color(at, F, schlick_cos) * (0.25 * shadowed), 0)
        normal_pdf = facing * cos_d
        refracted = dr.select(at.front, at.clear, 1) * (1 - F) if transmits else 0
        pdf = specular * (1 - refracted) * normal_pdf * jacobian

        # Lobes that only the front has.
        front = self._diffuse(at, wi.z, cos_o, cos_d)
        front_pdf = body * cos_o * (1 / math.pi)
        if at.coat is not None:
            d = at.coat.eval(h)
            g = smith_g1(wi, COAT_SHADOWING) * smith_g1(wo, COAT_SHADOWING)
            front += 0.25 * scalars["clearcoat"] * schlick(schlick_cos, Float(COAT_R0)) * d * g * cos_o
            front_pdf += coat * d * h.z * jacobian
        if at.passed is None:
            return dr.select(reflects, value + front, 0), dr.select(reflects, pdf + front_pdf, 0)
        value += dr.select(at.front, front, 0)
        pdf += front_pdf

        # The factor eta^2 of radiance that enters a denser medium cancels the one of the Jacobian.
        jacobian = -o_h * dr.rcp(length_squared)
        scale = 1 if ctx.mode == TransportMode.Radiance else dr.square(at.eta)
        through = at.clear * (1 - F) * shadowed * cos_d * jacobian * scale
        refracts = ~reflects & (i_h > 0) & (o_h < 0)
        passed = dr.select(refracts, at.passed * through, 0)
        passed_pdf = dr.select(refracts, specular * refracted * normal_pdf * jacobian * dr.square(at.eta), 0)
        return dr.select(reflects, value, passed), dr.select(reflects, pdf, passed_pdf)

    def _specular_color(self, at: At, F: Float, schlick_cos: Float) -> Color3f:
        """The reflectance of the main lobe: of glass, metal and tinted glass; from inside of glass alone."""
        scalars = at.scalars
        metallic, tinted = scalars.get("metallic", 0), scalars.get("spec_tint", 0)
        color = Color3f((1 - metallic) * (1 - tinted) * F)
        if "metallic" in scalars:
            color += metallic * schlick(schlick_cos, at.base_color)
        if "spec_tint" in scalars:
            r0 = tint(at.base_color) * schlick_r0(at.eta)
            color += (1 - metallic) * tinted * schlick(schlick_cos, r0)
        return dr.select(at.front, color, Color3f(at.inside * F)) if at.passed is not None else color

    def _diffuse(self, at: At, cos_i: Float, cos_o: Float, cos_d: Float) -> Color3f:
        """The diffuse lobe and the sheen, times cos_o."""
        scalars = at.scalars
        f = diffuse(cos_i, cos_o, cos_d, at.roughness, scalars.get("flatness"))
        value = at.base_color * (at.opaque * f * (1 / math.pi))
        if "sheen" in scalars:
            not_metal = 1 - scalars.get("metallic", 0)
            value += sheen(at.base_color, cos_d, scalars["sheen"] * not_metal, scalars.get("sheen_tint"))
        return value * cos_o


register_bsdf("principled", Principled)
