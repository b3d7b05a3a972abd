"""Hair: rough dielectric fibres that absorb light."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import drjit as dr

from djpt.core.color import LUMINANCE
from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.core.warp import square_to_rough_fiber_pdf
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_bsdf
from djpt.errors import SceneError
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32, Vector3f
from djpt.materials.base import BSDFAtPoint, SharedWorkBSDF
from djpt.materials.fresnel import fresnel
from djpt.materials.ior import ETA, ior

__all__ = ["Hair"]

LOBES = 3
"""Lobes of their own: reflection (R), two passages (TT), two passages and a reflection within (TRT)."""

EUMELANIN, PHEOMELANIN = (0.419, 0.697, 1.37), (0.187, 0.4, 1.05)
"""Absorption by the pigments per unit of concentration and of the fibre's radius (d'Eon et al. 2011)."""

SMOOTHEST = 0.01
"""Smoother fibres than this are beyond single precision."""

DIFFERENTIABLE = ParamFlags.Differentiable | ParamFlags.Discontinuous


class Hair(SharedWorkBSDF):
    """A fibre along the y axis of the shading frame (dp/dv), hit at the height that `wi` tells.

    Light is reflected at the surface, passes, or passes after a reflection within, each a lobe of its own; what
    passes after more reflections is one lobe, the same all around the fibre:

        f cos theta_o = sum over p of M_p(theta_i, theta_o) N_p(phi) A_p.

    M_p is the longitudinal lobe of d'Eon et al., tilted by the scales of the hair's surface, N_p a logistic
    distribution around the ideal direction, and A_p the fraction of light that reaches it: Fresnel's reflectance and
    what the inside absorbs. Energy is conserved: without absorption, the A_p add up to 1.

    Parameters:
        longitudinal_roughness, azimuthal_roughness: along and around the fibre (in [0, 1], default 0.3; at least 0.01
            counts).
        scale_tilt: angle of the scales in degrees (default 2).
        int_ior, ext_ior: index of refraction of the hair and around it (> 0, or a name of `djpt.materials.ior.IOR`;
            defaults `amber`, `air`), which must differ. As a parameter their quotient, `eta`.
        eumelanin, pheomelanin: concentrations of the brown and of the reddish pigment (>= 0, default 1.3 and 0.2); or
        sigma_a: absorption per radius of the fibre (texture >= 0), multiplied by `scale` (default 1).

    E. d'Eon, G. Francois, M. Hill, J. Letteri and J.-M. Aubry, "An Energy-Conserving Hair Reflectance Model" (EGSR
    2011); M. J.-Y. Chiang, B. Bitterli, C. Tappan and B. Burley, "A Practical and Controllable Hair and Fur Model for
    Production Path Tracing" (CGF 35(2), 2016), for the lobes' roughness; M. Pharr, "The Implementation of a Hair
    Scattering Model" (2016), for tilts and sampling.
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = {
        "longitudinal_roughness": DIFFERENTIABLE,
        "azimuthal_roughness": DIFFERENTIABLE,
        "scale_tilt": DIFFERENTIABLE,
        "eta": DIFFERENTIABLE,
        "eumelanin": DIFFERENTIABLE,
        "pheomelanin": DIFFERENTIABLE,
        "scale": ParamFlags.NonDifferentiable,
    }
    allowed: ClassVar[Mapping[str, Allowed]] = {
        **ETA,
        **dict.fromkeys(("longitudinal_roughness", "azimuthal_roughness"), Allowed(0.0, 1.0)),
        **dict.fromkeys(("eumelanin", "pheomelanin", "scale"), Allowed(0.0)),
    }
    children = ("sigma_a",)
    statics: ClassVar[Sequence[str]] = ("use_pigmentation",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.longitudinal_roughness, self.azimuthal_roughness = (
            as_float(props.float(f"{name}_roughness", 0.3, low=0.0, high=1.0)) for name in ("longitudinal", "azimuthal")
        )
        self.scale_tilt = as_float(props.float("scale_tilt", 2.0))
        inner, outer = ior(props, "int_ior", "amber"), ior(props, "ext_ior", "air")
        if inner == outer:
            raise SceneError(f"{props.node}: 'int_ior' must differ from 'ext_ior', found {inner:.9g} for both")
        self.eta = as_float(inner / outer)
        self.eumelanin = as_float(props.float("eumelanin", 1.3, low=0.0))
        self.pheomelanin = as_float(props.float("pheomelanin", 0.2, low=0.0))
        self.use_pigmentation = "sigma_a" not in props
        if not self.use_pigmentation:
            for pigment in ("eumelanin", "pheomelanin"):
                if pigment in props:
                    raise props.error(
                        pigment, "can't be combined with 'sigma_a': give either pigments or the absorption"
                    )
        self.sigma_a = None if self.use_pigmentation else props.texture("sigma_a", low=0.0)
        self.scale = as_float(props.float("scale", 1.0, low=0.0))

    def traverse(self, callback: TraversalCallback) -> None:
        for name, flags in self.values.items():
            callback.put(name, getattr(self, name), flags)
        callback.put("use_pigmentation", self.use_pigmentation, ParamFlags.NonDifferentiable | ParamFlags.ReadOnly)
        if self.sigma_a is not None:
            callback.put("sigma_a", self.sigma_a)

    def components(self) -> tuple[int, ...]:
        fibre = BSDFFlags.Glossy | BSDFFlags.FrontSide | BSDFFlags.Anisotropic | BSDFFlags.NonSymmetric
        return int(fibre), int(BSDFFlags.Null | BSDFFlags.BackSide)

    def is_asked(self, ctx: BSDFContext) -> bool:
        return self.asked(ctx)[0]  # nothing passes straight through, although Mitsuba lists that lobe

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return HairAtPoint(self, si, active)

    def absorption(self, si: SurfaceInteraction3f, active: Bool | bool) -> Color3f:
        """The absorption per radius of the fibre."""
        if self.sigma_a is not None:
            return self.sigma_a.eval(si, active) * self.scale
        return Color3f(*EUMELANIN) * self.eumelanin + Color3f(*PHEOMELANIN) * self.pheomelanin


class HairAtPoint:
    """A `Hair` at one point, seen from `wi`: the work that evaluation and sampling share.

    `theta` is the angle with the plane across the fibre, `phi` the angle around it, `gamma` that between the normal
    and a direction within this plane; h = sin gamma is the height at which light meets the fibre.
    """

    def __init__(self, bsdf: Hair, si: SurfaceInteraction3f, active: Bool | bool) -> None:
        wi = self.wi = si.wi
        self.sin_i = wi.y
        self.cos_i = dr.safe_sqrt(dr.fma(-wi.y, wi.y, 1))
        along = ~(dr.square(wi.x) + dr.square(wi.z) > 0)  # no height: light runs along the fibre
        self.phi_i = dr.select(along, Float(0), dr.atan2(wi.z, dr.select(along, 1, wi.x)))
        self.gamma_i = dr.select(along, Float(0), dr.atan2(-wi.x, dr.select(along, 1, wi.z)))
        h, cos_gamma_i = dr.sincos(self.gamma_i)
        # Refracted directions, along the fibre and across it.
        cos_t = dr.safe_sqrt(1 - dr.square(self.sin_i / bsdf.eta))
        sin_gamma_t = h * self.cos_i * dr.rsqrt(dr.maximum(dr.square(bsdf.eta) - dr.square(self.sin_i), 1e-8))
        self.gamma_t = dr.safe_asin(sin_gamma_t)
        cos_gamma_t = dr.safe_sqrt(1 - dr.square(sin_gamma_t))
        # 1e-4 radii above the horizon, or light that can't enter, would be infinitely far from the other side.
        passage = 2 * cos_gamma_t / dr.maximum(cos_t, 1e-4)
        passed = dr.exp(-bsdf.absorption(si, active) * passage)
        self.shares = shares_of(fresnel(self.cos_i * dr.abs(cos_gamma_i), bsdf.eta)[0], passed)
        brightness = [share.x * LUMINANCE[0] + share.y * LUMINANCE[1] + share.z * LUMINANCE[2] for share in self.shares]
        inverse = dr.rcp(sum(brightness[1:], brightness[0]))
        self.probabilities = [dr.detach(b * inverse) for b in brightness]
        self.kappas = [dr.rcp(v) for v in longitudinal_variances(bsdf.longitudinal_roughness)]
        self.around = Logistic(azimuthal_scale(bsdf.azimuthal_roughness))
        self.tilted = tilted_angles(self.sin_i, self.cos_i, dr.deg2rad(bsdf.scale_tilt))

    def ideal(self, p: int) -> Float:
        """The change of phi after p passages through a smooth fibre."""
        return 2 * p * self.gamma_t - 2 * self.gamma_i + p * math.pi

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        across = dr.square(wo.x) + dr.square(wo.z) > 0
        phi_o = dr.select(across, dr.atan2(wo.z, dr.select(across, wo.x, 1)), Float(0))
        turn = phi_o - self.phi_i
        sin_phi, cos_phi = dr.sincos(self.phi_i)
        fibre = Vector3f(0, 1, 0)
        value, pdf = Color3f(0), Float(0)
        for p in range(LOBES):
            sin, cos = self.tilted[p]
            tilted = Vector3f(cos * cos_phi, sin, cos * sin_phi)
            lobe = square_to_rough_fiber_pdf(wo, tilted, fibre, self.kappas[p])
            lobe *= 2 * math.pi * self.around.pdf(turn - self.ideal(p))
            value += self.shares[p] * lobe
            pdf += self.probabilities[p] * lobe
        lobe = square_to_rough_fiber_pdf(wo, self.wi, fibre, self.kappas[LOBES])
        value += self.shares[LOBES] * lobe
        pdf += self.probabilities[LOBES] * lobe
        return value, dr.detach(pdf)

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        lobe, rest = self._choose(sample1)
        sin, cos, kappa = self.sin_i, self.cos_i, self.kappas[LOBES]
        turn = 2 * math.pi * rest
        for p in range(LOBES):
            chosen = lobe == p
            sin, cos = dr.select(chosen, self.tilted[p][0], sin), dr.select(chosen, self.tilted[p][1], cos)
            kappa = dr.select(chosen, self.kappas[p], kappa)
            turn = dr.select(chosen, self.ideal(p) + self.around.sample(rest), turn)
        # A lobe around the cone of mirror directions: its angle with the cone, then around it.
        c = 1 + dr.log(sample2.x + (1 - sample2.x) * dr.exp(-2 * kappa)) / kappa
        c = dr.clip(c, -1, 1)
        s = dr.safe_sqrt(1 - dr.square(c)) * dr.cos(2 * math.pi * sample2.y)
        sin_o = dr.clip(s * cos - c * sin, -1, 1)
        cos_o = dr.safe_sqrt(1 - dr.square(sin_o))
        sin_phi, cos_phi = dr.sincos(self.phi_i + turn)
        wo = dr.normalize(Vector3f(cos_o * cos_phi, sin_o, cos_o * sin_phi))
        value, pdf = self.eval_pdf(wo)
        weight = dr.select(pdf > 0, value * dr.rcp(dr.select(pdf > 0, pdf, 1)), 0)
        return BSDFSample3f.of(wo, pdf, BSDFFlags.Glossy), weight

    def _choose(self, sample: Float) -> tuple[UInt32, Float]:
        """A lobe by its probability, and the number in [0, 1] that is left of the sample."""
        lobe, rest = UInt32(0), sample * dr.rcp(self.probabilities[0])
        for p in range(LOBES):
            beyond = sample > self.probabilities[p]
            sample = sample - self.probabilities[p]
            lobe = dr.select(beyond, UInt32(p + 1), lobe)
            rest = dr.select(beyond, sample * dr.rcp(self.probabilities[p + 1]), rest)
        return lobe, dr.clip(rest, 0, 1)


def shares_of(reflected: Float, passed: Color3f) -> list[Color3f]:
    """The shares of light that leave after 0, 1, .. reflections within: `LOBES` of them, and the sum of all others.

    `reflected` is Fresnel's reflectance, `passed` what is left of light after one passage.
    """
    shares = [Color3f(reflected), dr.square(1 - reflected) * passed]
    for _ in range(2, LOBES):
        shares.append(shares[-1] * passed * reflected)
    again = passed * reflected
    return [*shares, shares[-1] * again * dr.rcp(dr.maximum(1 - again, 1e-6))]


def longitudinal_variances(roughness: Float) -> list[Float]:
    """The variance of each lobe along the fibre (Chiang et al., equation 7); the last one is that of all others."""
    r = dr.maximum(roughness, SMOOTHEST)
    r4 = dr.square(dr.square(r))
    first = dr.square(0.726 * r + 0.812 * dr.square(r) + 3.7 * r4 * dr.square(dr.square(r4)))
    return [first, 0.25 * first, 4 * first, 4 * first]


def azimuthal_scale(roughness: Float) -> Float:
    """The scale of the logistic distribution around the fibre (Chiang et al., equation 8)."""
    r = dr.maximum(roughness, SMOOTHEST)
    r2 = dr.square(r)
    r22 = r2 * dr.square(r2) * dr.square(dr.square(dr.square(dr.square(r))))
    return math.sqrt(math.pi / 8) * (0.265 * r + 1.194 * r2 + 5.372 * r22)


def tilted_angles(sin: Float, cos: Float, tilt: Float) -> list[tuple[Float, Float]]:
    """The sine and cosine of theta_i as each lobe sees it: turned by -2, 1 and 4 times the tilt of the scales."""
    angles = []
    for turn in (-2, 1, 4):
        s, c = dr.sincos(turn * tilt)
        angles.append((dr.fma(sin, c, cos * s), dr.abs(dr.fma(cos, c, -sin * s))))
    return angles


class Logistic:
    """The logistic distribution of an angle in [-pi, pi]: 1 / (4 s cosh(x / (2 s))^2), divided by what lies within."""

    def __init__(self, scale: Float) -> None:
        self.scale = scale
        self.outside = dr.rcp(1 + dr.exp(math.pi / scale))
        """The probability of all angles below -pi, which aren't there."""
        self.within = 1 - 2 * self.outside

    def pdf(self, angle: Float) -> Float:
        """The density at any angle, which is brought into the range."""
        angle = angle - 2 * math.pi * dr.round(angle * (0.5 / math.pi))
        e = dr.exp(-dr.abs(angle) / self.scale)
        return e / (self.scale * dr.square(1 + e) * self.within)

    def sample(self, u: Float) -> Float:
        """An angle."""
        below = dr.fma(u, self.within, self.outside)
        return dr.clip(-self.scale * dr.log(dr.rcp(below) - 1), -math.pi, math.pi)


register_bsdf("hair", Hair)
