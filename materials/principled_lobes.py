"""The lobes of Disney's principled model, and the common part of its two materials.

B. Burley, "Physically-based shading at Disney", SIGGRAPH 2012 course notes; B. Burley, "Extending the
Disney BRDF to a BSDF with integrated subsurface scattering", SIGGRAPH 2015 course notes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import drjit as dr

from djpt.core.color import LUMINANCE
from djpt.core.records import BSDFContext, BSDFSample3f, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.jit.kernels import maximum, minimum
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Vector3f
from djpt.materials.base import BSDFAtPoint, SharedWorkBSDF
from djpt.textures.base import Texture

__all__ = [
    "GTR1",
    "PrincipledBase",
    "Scalars",
    "alphas",
    "diffuse",
    "half_vector",
    "inverse",
    "schlick_r0",
    "sheen",
    "smith_g1",
    "square_root",
    "tint",
]

GRAZING = 1e-7
"""Directions of a smaller cosine are lost: the squares and their inverses would leave float32."""

Scalars = dict[str, Any]
"""The optional parameters at one surface point, without those that are off."""


class PrincipledBase(SharedWorkBSDF):
    """The common part of both materials: the parameters are read once per surface point.

    Parameters that aren't in the description (or are the number 0 there) are off: their lobes aren't
    in the kernel. Editing one turns it on.

    The model is evaluated in the local frame mirrored at the origin where `wi` is below the surface: there
    wi.z > 0. GGX is symmetric under this.
    """

    optional: ClassVar[tuple[str, ...]] = ()
    statics: ClassVar[Sequence[str]] = ("given",)

    given: frozenset[str]
    """The names of the optional parameters that are on."""
    base_color: Texture

    def _read_optional(self, props: Properties, high: dict[str, float] | None = None) -> None:
        for key in self.optional:
            setattr(self, key, props.texture_1(key, 0.0, low=0.0, high=(high or {}).get(key, 1.0)))
        self.given = frozenset(key for key in self.optional if key in props and props.raw(key) != 0)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        self.given |= frozenset(keys) & frozenset(self.optional)

    def _scalars(self, si: SurfaceInteraction3f, active: Bool | bool) -> Scalars:
        return {key: getattr(self, key).eval_1(si, active) for key in sorted(self.given)}

    # ---- what the materials add ------------------------------------------------------------

    def look_up(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> Any:
        """All parameters at `si`."""
        raise NotImplementedError

    def eval_pdf_mirrored(self, at: Any, ctx: BSDFContext, wi: Vector3f, wo: Vector3f) -> tuple[Color3f, Float]:
        """`eval_pdf` in the mirrored frame; no cosine is smaller than `GRAZING`."""
        raise NotImplementedError

    def draw(self, at: Any, wi: Vector3f, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Bool]:
        """A direction in the mirrored frame, without its density, and whether it is possible."""
        raise NotImplementedError

    def is_seen(self, at: Any) -> Bool | bool:
        """True where the material scatters light to the side that it is seen from."""
        return True

    # ---- the contract of BSDFs -------------------------------------------------------------

    def is_asked(self, ctx: BSDFContext) -> bool:
        """True: all lobes are evaluated together, whichever a context asks for."""
        return True

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return PrincipledAtPoint(self, ctx, si, active)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.base_color.eval(si, active)


class PrincipledAtPoint:
    """A `PrincipledBase` at one point, seen from `wi`: the work that evaluation and sampling share."""

    def __init__(self, bsdf: PrincipledBase, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> None:
        self.bsdf, self.ctx, self.wi, self.parameters = bsdf, ctx, si.wi, bsdf.look_up(ctx, si, active)

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        wi, bsdf = self.wi, self.bsdf
        usable = (dr.abs(wi.z) > GRAZING) & (dr.abs(wo.z) > GRAZING) & bsdf.is_seen(self.parameters)
        # Lanes that count for nothing get directions without singularities, for the sake of gradients.
        up = Vector3f(0, 0, 1)
        towards, onward = (dr.select(usable, dr.mulsign(w, wi.z), up) for w in (wi, wo))
        value, pdf = bsdf.eval_pdf_mirrored(self.parameters, self.ctx, towards, onward)
        return dr.select(usable, value, 0), dr.select(usable, pdf, 0)

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        usable = dr.abs(self.wi.z) > GRAZING
        mirrored = dr.select(usable, dr.mulsign(self.wi, self.wi.z), Vector3f(0, 0, 1))
        bs, possible = self.bsdf.draw(self.parameters, mirrored, sample1, sample2)
        bs.wo = dr.detach(dr.mulsign(bs.wo, self.wi.z))
        value, pdf = self.eval_pdf(bs.wo)
        pdf = dr.detach(pdf)
        possible &= usable & (pdf > 0)
        bs.pdf = dr.select(possible, pdf, 0)
        return bs, dr.select(possible, value * inverse(pdf), 0)


# ---- arithmetic ------------------------------------------------------------------------------


def inverse(x: Float) -> Float:
    """The inverse 1 / x; 1 where x is 0 and the result counts for nothing."""
    return dr.rcp(dr.select(x > 1e-30, x, 1))


def square_root(x: Any) -> Any:
    """The square root of max(x, 0); while derivatives are followed, of a number 1e-8 larger.

    At 0 the slope is infinite, but that of a product of two roots isn't: light that is refracted twice.
    """
    if dr.grad_enabled(x):
        x = x + 1e-8
    positive = x > 0
    return dr.select(positive, dr.sqrt(dr.select(positive, x, 1)), 0)


def half_vector(wi: Vector3f, wo: Vector3f) -> tuple[Vector3f, Float]:
    """The normalised sum of both directions, turned to z > 0, and the squared length of the sum."""
    h = wi + wo
    length_squared = maximum(dr.squared_norm(h), 1e-20)
    h = h * dr.rsqrt(length_squared)
    return dr.mulsign(h, h.z), length_squared


# ---- Fresnel ---------------------------------------------------------------------------------


def schlick_weight(cos_theta: Float) -> Float:
    """Schlick's weight (1 - cos theta)^5, with the base clipped to [0, 1]."""
    m = minimum(maximum(1 - cos_theta, 0), 1)
    return dr.square(dr.square(m)) * m


def schlick_r0(eta: Float) -> Float:
    """The reflectance of an interface at normal incidence."""
    return dr.square((eta - 1) * dr.rcp(eta + 1))


def tint(color: Color3f) -> Color3f:
    """The hue of a colour: the colour over its luminance; white for black."""
    r, g, b = LUMINANCE
    luminance = color.x * r + color.y * g + color.z * b
    lit = luminance > 1e-30
    return dr.select(lit, color * dr.rcp(dr.select(lit, luminance, 1)), 1)


# ---- distributions of microfacets -----------------------------------------------------------


def alphas(roughness: Float, anisotropic: Float | None) -> tuple[Float, Float]:
    """Alpha along u and v: the squared roughness, stretched by the aspect sqrt(1 - 0.9 anisotropic); at least 0.001."""
    squared = dr.square(roughness)
    if anisotropic is None:
        alpha = maximum(squared, 0.001)
        return alpha, alpha
    aspect = dr.sqrt(1 - 0.9 * anisotropic)
    return maximum(squared * dr.rcp(aspect), 0.001), maximum(squared * aspect, 0.001)


class GTR1:
    """The generalised Trowbridge-Reitz distribution with exponent 1: the long tail of the clear coat.

    D(m) = (a^2 - 1) / (pi ln(a^2) (1 + (a^2 - 1) cos^2)), isotropic, 0 < a < 1 (Burley 2012, appendix B).
    """

    def __init__(self, alpha: Float) -> None:
        self._alpha_squared = dr.square(alpha)

    def eval(self, m: Vector3f) -> Float:
        """The density D(m) of normals, for m.z > 0."""
        a2 = self._alpha_squared
        # 1 + (a^2 - 1) cos^2, written as a sum without cancellation.
        spread = dr.fma(a2, dr.square(m.z), dr.square(m.x) + dr.square(m.y))
        return (a2 - 1) * dr.rcp(math.pi * dr.log(a2) * spread)

    def sample(self, sample: Point2f) -> Normal3f:
        """A normal with the density D(m) cos theta."""
        a2 = self._alpha_squared
        sin_phi, cos_phi = dr.sincos(2 * math.pi * sample.x)
        cos_squared = (1 - dr.exp2(dr.log2(a2) * (1 - sample.y))) * dr.rcp(1 - a2)
        sin, cos = dr.safe_sqrt(1 - cos_squared), dr.safe_sqrt(cos_squared)
        return Normal3f(cos_phi * sin, sin_phi * sin, cos)


def smith_g1(v: Vector3f, alpha: float) -> Float:
    """Smith's shadowing of an isotropic GGX surface: 2 cos / (cos + sqrt(cos^2 + alpha^2 sin^2))."""
    cos_squared, sin_squared = dr.square(v.z), dr.square(v.x) + dr.square(v.y)
    cos = dr.abs(v.z)
    return 2 * cos * dr.rcp(cos + dr.sqrt(dr.fma(sin_squared, alpha**2, cos_squared)))


# ---- diffuse lobes --------------------------------------------------------------------------


def diffuse(cos_i: Float, cos_o: Float, cos_d: Float, roughness: Float, flatness: Float | None) -> Float:
    """The diffuse lobe times pi, with retro-reflection (2015, eq. 4), blended with flat subsurface scattering.

    `cos_d` is the cosine between the half vector and either direction.
    """
    f_i, f_o = schlick_weight(cos_i), schlick_weight(cos_o)
    retro = 2 * roughness * dr.square(cos_d)
    f = (1 - 0.5 * f_i) * (1 - 0.5 * f_o) + retro * (f_o + f_i + f_o * f_i * (retro - 1))
    if flatness is None:
        return f
    # Hanrahan and Krueger's shape, fitted: half the retro-reflection flattens it towards the horizon.
    f_ss = dr.lerp(1, 0.5 * retro, f_o) * dr.lerp(1, 0.5 * retro, f_i)
    flat = 1.25 * (f_ss * (dr.rcp(cos_o + cos_i) - 0.5) + 0.5)
    return dr.lerp(f, flat, flatness)


def sheen(color: Color3f, cos_d: Float, amount: Float, tinted: Float | None) -> Color3f:
    """The f of a lobe of cloth at grazing angles, white or partly of the colour's hue."""
    f = amount * schlick_weight(cos_d)
    return Color3f(f) if tinted is None else f * dr.lerp(Color3f(1), tint(color), tinted)
