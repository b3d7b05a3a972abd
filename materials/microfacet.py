"""Distributions of microfacet normals: Beckmann and GGX."""

from __future__ import annotations

import math
from typing import Any, Final

import drjit as dr

from djpt.core.records import BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.core.warp import square_to_cosine_hemisphere, square_to_uniform_disk_concentric
from djpt.description.properties import Properties
from djpt.errors import SceneError, near_miss
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, UInt32, Vector2f, Vector3f
from djpt.materials.base import SharedWorkBSDF
from djpt.materials.fresnel import reflect
from djpt.textures.base import Texture

__all__ = [
    "ALPHAS",
    "MIN_ALPHA",
    "FacetsAtPoint",
    "MicrofacetDistribution",
    "RoughBSDF",
    "RoughCoatAtPoint",
    "distribution_name",
]

DISTRIBUTIONS: Final = ("beckmann", "ggx")

MIN_ALPHA = 1e-4
"""Smoother surfaces than this are beyond single precision (Mitsuba's bound)."""

INV_PI = 1 / math.pi
INV_SQRT_PI = 1 / math.sqrt(math.pi)
BELOW_ONE = 1 - 2.0**-24
"""The largest float below 1."""


class MicrofacetDistribution:
    """A distribution of microfacet normals m about +z, and of those that a direction sees.

    With s = (m.x / alpha_u)^2 + (m.y / alpha_v)^2 over the upper hemisphere:

    * `beckmann`: D = exp(-s / m.z^2) / (pi alpha_u alpha_v m.z^4): Gaussian slopes;
    * `ggx` (Trowbridge-Reitz): D = 1 / (pi alpha_u alpha_v (s + m.z^2)^2): longer tails.

    The integral of D m.z over the hemisphere is 1. Shadowing is Smith's, separable in wi and wo;
    that of `beckmann` is a rational fit with a relative error below 0.35 %.

    Args:
        distribution: `"beckmann"` or `"ggx"`.
        alpha_u, alpha_v: roughness along x and y, at least 1e-4. One object given twice means
            an isotropic surface, for which less is computed.
        sample_visible: sample only the normals that `wi` sees, with the density
            D_wi(m) = D(m) G1(wi, m) dot(wi, m) / cos theta_i; otherwise all, with D(m) m.z.

    Sources: Walter et al., "Microfacet Models for Refraction through Rough Surfaces" (EGSR 2007), for D,
    G1 and the sampling of all normals; Heitz and d'Eon, "Importance Sampling Microfacet-Based BSDFs using the
    Distribution of Visible Normals" (EGSR 2014), for the stretching; Jakob, "An Improved Visible Normal
    Sampling Routine for the Beckmann Distribution" (2014); Heitz, "Sampling the GGX Distribution of Visible
    Normals" (JCGT 7(4), 2018).
    """

    def __init__(self, distribution: str, alpha_u: Float, alpha_v: Float, sample_visible: bool = True) -> None:
        self.distribution = distribution
        self.sample_visible = sample_visible
        self.isotropic = alpha_u is alpha_v
        self.alpha_u = dr.select(alpha_u > MIN_ALPHA, alpha_u, MIN_ALPHA)
        self.alpha_v = self.alpha_u if self.isotropic else dr.select(alpha_v > MIN_ALPHA, alpha_v, MIN_ALPHA)

    def scaled(self, factor: Float) -> MicrofacetDistribution:
        """The distribution with both roughnesses multiplied by `factor`."""
        alpha_u = self.alpha_u * factor
        alpha_v = alpha_u if self.isotropic else self.alpha_v * factor
        return MicrofacetDistribution(self.distribution, alpha_u, alpha_v, self.sample_visible)

    # ---- density ----------------------------------------------------------------------

    def eval(self, m: Vector3f) -> Float:
        """The density D(m), per unit solid angle; 0 below the horizon and where D m.z is below 1e-20."""
        # Fractions are expanded so that one reciprocal is left: nothing overflows where D isn't 0.
        z2 = dr.square(m.z)
        if self.isotropic:
            a2 = dr.square(self.alpha_u)
            xy = dr.fma(m.x, m.x, dr.square(m.y))
            if self.distribution == "beckmann":
                t = dr.rcp(a2 * z2)
                result = dr.exp(-xy * t) * dr.square(t) * (a2 * INV_PI)
            else:
                result = a2 * INV_PI * dr.square(dr.rcp(dr.fma(a2, z2, xy)))
        else:
            uv = self.alpha_u * self.alpha_v
            uv2 = dr.square(uv)
            xy = dr.square(m.x * self.alpha_v) + dr.square(m.y * self.alpha_u)
            if self.distribution == "beckmann":
                t = dr.rcp(uv2 * z2)
                result = dr.exp(-xy * t) * dr.square(t) * (uv2 * uv * INV_PI)
            else:
                result = uv2 * uv * INV_PI * dr.square(dr.rcp(dr.fma(uv2, z2, xy)))
        return dr.select(result * m.z > 1e-20, result, 0)

    def pdf(self, wi: Vector3f, m: Vector3f) -> Float:
        """The density of `sample` at `m`, per unit solid angle; `wi` must be above the horizon."""
        if not self.sample_visible:
            return self.eval(m) * m.z
        cos = dr.dot(wi, m)
        return dr.select(cos * wi.z > 0, self.eval(m) * self.smith_g1_over_cos(wi) * dr.abs(cos), 0)

    # ---- shadowing --------------------------------------------------------------------

    def smith_g1_over_cos(self, v: Vector3f) -> Float:
        """G1 / abs(v.z) for microfacets that face `v`: finite at the horizon, where both vanish."""
        z = dr.abs(v.z)
        if self.isotropic:
            xy = dr.square(self.alpha_u) * dr.fma(v.x, v.x, dr.square(v.y))
        else:
            xy = dr.square(self.alpha_u * v.x) + dr.square(self.alpha_v * v.y)
        if self.distribution == "ggx":
            return 2 * dr.rcp(z + dr.sqrt(dr.fma(z, z, xy)))
        # Walter et al., section 5.2. a = 1 / (alpha tan theta); looking straight down it is infinite.
        inv = dr.rsqrt(xy)
        a = z * inv
        unshadowed = a >= 1.6
        numerator = dr.select(unshadowed, 1, inv * dr.fma(2.181, a, 3.535))
        return numerator * dr.rcp(dr.select(unshadowed, z, dr.fma(dr.fma(2.577, a, 2.276), a, 1)))

    def smith_g1(self, v: Vector3f, m: Vector3f) -> Float:
        """The fraction of microfacets with normal `m` that `v` sees: fronts from above, backs from below, else 0."""
        g1 = self.smith_g1_over_cos(v) * dr.abs(v.z)
        return dr.select(dr.dot(v, m) * v.z > 0, g1, 0)

    def G(self, wi: Vector3f, wo: Vector3f, m: Vector3f) -> Float:
        """The shadowing for two directions, G1(wi, m) G1(wo, m)."""
        return self.smith_g1(wi, m) * self.smith_g1(wo, m)

    # ---- sampling ---------------------------------------------------------------------

    def sample(self, wi: Vector3f, sample: Point2f) -> tuple[Normal3f, Float]:
        """A normal and its density; `wi` (above the horizon) matters to visible normals only."""
        m = self.sample_normal(wi, sample)
        return m, self.pdf(wi, m)

    def sample_normal(self, wi: Vector3f, sample: Point2f) -> Normal3f:
        """A normal, as by `sample`, without its density."""
        if not self.sample_visible:
            return self._sample_all(sample)
        # The surface of roughness 1 that is seen from the stretched direction, in the plane of incidence.
        stretched = dr.normalize(Vector3f(self.alpha_u * wi.x, self.alpha_v * wi.y, wi.z))
        sin2 = dr.fma(stretched.x, stretched.x, dr.square(stretched.y))
        inv_sin = dr.rsqrt(sin2)
        tilted = sin2 > 4 * 2.0**-24
        cos_phi = dr.select(tilted, stretched.x * inv_sin, 1)
        sin_phi = dr.select(tilted, stretched.y * inv_sin, 0)
        # Directions below the horizon must give numbers, too, even if they mean nothing.
        cos = dr.select(stretched.z > 1e-7, stretched.z, 1e-7)
        n = self.sample_11(cos, sample)
        x, y = dr.fma(cos_phi, n.x, -sin_phi * n.y), dr.fma(sin_phi, n.x, cos_phi * n.y)
        return dr.normalize(Normal3f(self.alpha_u * x, self.alpha_v * y, n.z))

    def sample_11(self, cos: Float, sample: Point2f) -> Vector3f:
        """A normal of roughness 1 visible from the direction (sin, 0, cos), of any length."""
        if self.distribution == "beckmann":
            return _visible_beckmann(cos, sample)
        return _visible_ggx(cos, sample)

    def _sample_all(self, sample: Point2f) -> Normal3f:
        """A normal of all, seen or not: the length of its slope by inversion, scaled by the roughnesses."""
        sin, cos = dr.sincos(2 * math.pi * sample.y)
        rest = 1 - sample.x
        radius2 = -dr.log(rest) if self.distribution == "beckmann" else sample.x * dr.rcp(rest)
        radius = _sqrt(radius2)
        return dr.normalize(Normal3f(self.alpha_u * radius * cos, self.alpha_v * radius * sin, 1))


def _visible_ggx(cos: Float, sample: Point2f) -> Vector3f:
    """A normal of roughness 1 visible from (sin, 0, cos), unit length: a visible point of the unit hemisphere."""
    p = square_to_uniform_disk_concentric(sample)
    # The disk as seen from the side: its far half is the visible part of the equator's disk.
    edge = _sqrt(dr.fma(-p.x, p.x, 1))
    y = dr.lerp(edge, p.y, dr.fma(0.5, cos, 0.5))
    z = _sqrt(1 - dr.fma(p.x, p.x, dr.square(y)))
    sin = _sqrt(dr.fma(-cos, cos, 1))
    height = dr.fma(sin, y, cos * z)
    return Vector3f(dr.fma(sin, z, -cos * y), -p.x, dr.select(height > 0, height, 0))


def _visible_beckmann(cos: Float, sample: Point2f) -> Vector3f:
    """A normal of roughness 1 visible from (sin, 0, cos), not normalised.

    The slope along x has the distribution function C (1 + x + tan exp(-erfinv(x)^2) / sqrt(pi)) in terms of
    x = erf(slope). Three Newton steps invert it, from the solution for grazing incidence.
    """
    tan = _sqrt(dr.fma(-cos, cos, 1)) * dr.rcp(cos)
    cot = dr.rcp(tan)
    largest = dr.erf(cot)
    u = _clamp(sample.x, 1e-6, 1 - 1e-6)
    x = largest - (largest + 1) * dr.erf(dr.sqrt(-dr.log(u)))
    tan_pi = tan * INV_SQRT_PI
    target = u * (1 + largest + tan_pi * dr.exp(-dr.square(cot)))
    for _ in range(3):
        slope = dr.erfinv(_clamp(x, -BELOW_ONE, BELOW_ONE))
        value = 1 + x + tan_pi * dr.exp(-dr.square(slope)) - target
        x = x - value * dr.rcp(1 - slope * tan)
    v = _clamp(sample.y, 1e-6, 1 - 1e-6)
    slopes = dr.erfinv(Vector2f(_clamp(x, -BELOW_ONE, BELOW_ONE), dr.fma(2, v, -1)))
    return Vector3f(-slopes.x, -slopes.y, 1)


def _sqrt(x: Float) -> Float:
    """The square root; 0, with derivative 0, where rounding made `x` negative."""
    return dr.sqrt(dr.select(x > 0, x, 0))


def _clamp(x: Float, low: float, high: float) -> Float:
    x = dr.select(x > low, x, low)
    return dr.select(x < high, x, high)


# ---- what rough materials have in common ----------------------------------------------


def distribution_name(props: Properties) -> str:
    """The name under the key `distribution`: `"beckmann"` (default) or `"ggx"`, in any case."""
    name = props.string("distribution", "beckmann")
    if name.lower() not in DISTRIBUTIONS:
        raise props.error("distribution", f"can't be '{name}'{near_miss(name.lower(), DISTRIBUTIONS)}")
    return name.lower()


ALPHAS: Final = ("alpha", "alpha_u", "alpha_v")
"""The attributes of a `RoughBSDF` that are textures of roughness: the first one, or both others; the rest is None."""


class RoughBSDF(SharedWorkBSDF):
    """A BSDF with microfacets. Its `children` list `ALPHAS`, in the place where parameters are reported.

    Parameters:
        distribution: of the microfacets, `beckmann` (default) or `ggx`, in any case.
        alpha: roughness (scalar texture in [0, 1], default 0.1; at least 1e-4 counts); or
        alpha_u, alpha_v: roughness along dp/du and dp/dv.
        sample_visible: sample only microfacets that are seen (default true).
    """

    statics = ("distribution", "sample_visible")
    alpha: Texture | None = None
    alpha_u: Texture | None = None
    alpha_v: Texture | None = None

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.distribution = distribution_name(props)
        self.sample_visible = props.boolean("sample_visible", True)
        pair = [key for key in ALPHAS[1:] if key in props]
        if not pair:
            self.alpha = props.texture_1("alpha", 0.1, low=0.0, high=1.0)
            return
        if "alpha" in props:
            raise props.error(
                "alpha", f"can't be combined with '{pair[0]}': give either 'alpha' or 'alpha_u' and 'alpha_v'"
            )
        if len(pair) == 1:
            other = "alpha_v" if pair == ["alpha_u"] else "alpha_u"
            raise SceneError(f"{props.node}: '{pair[0]}' needs '{other}' as well; 'alpha' sets both")
        self.alpha_u, self.alpha_v = (props.texture_1(key, low=0.0, high=1.0) for key in pair)

    @property
    def anisotropy(self) -> BSDFFlags:
        """`BSDFFlags.Anisotropic` if there are two roughnesses, else no flag."""
        return BSDFFlags.Empty if self.alpha_v is None else BSDFFlags.Anisotropic

    def microfacets(self, si: SurfaceInteraction3f, active: Bool | bool) -> MicrofacetDistribution:
        """The distribution of microfacets at a point; textures of roughness often hold zeros, which it raises."""
        along_u: Any = self.alpha_u if self.alpha is None else self.alpha
        u = along_u.eval_1(si, active)
        v = u if self.alpha_v is None else self.alpha_v.eval_1(si, active)
        return MicrofacetDistribution(self.distribution, u, v, self.sample_visible)


class FacetsAtPoint:
    """Rough facets that reflect, at one point, seen from `wi`."""

    wi: Vector3f
    surface: MicrofacetDistribution
    g1_i: Float
    """G1(wi) over the cosine of `wi`."""

    def facets(self, wo: Vector3f) -> tuple[Bool, Float, Float, Float]:
        """The facets that reflect `wi` towards `wo`.

        Returns:
            Whether both directions are above the horizon; the cosine between them and the facets' normal; D G1(wi) / 4
            over the cosine of `wi`; the density of `wo` if the facets are sampled.
        """
        # The half vector of two directions above the horizon faces both of them.
        ok = (self.wi.z > 0) & (wo.z > 0)
        h = self.wi + wo
        m = h * dr.rsqrt(dr.select(ok, dr.squared_norm(h), 1))
        cos = dr.dot(self.wi, m)
        d = self.surface.eval(m)
        visible = 0.25 * d * self.g1_i
        pdf = visible if self.surface.sample_visible else d * m.z * 0.25 * dr.rcp(dr.select(ok, cos, 1))
        return ok, cos, visible, pdf


class RoughCoatAtPoint(FacetsAtPoint):
    """Samples one of two lobes, facets (component 0) or base (component 1), by a probability that is known before."""

    p_specular: Float
    """The probability of the facets."""

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        """The value of both lobes, f cos theta_o, and the density of `sample`."""
        raise NotImplementedError

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        """Sample a lobe and a direction of it; the weight is that of both lobes."""
        specular = sample1 < self.p_specular
        m = self.surface.sample_normal(self.wi, sample2)
        wo = dr.select(specular, reflect(self.wi, m), square_to_cosine_hemisphere(sample2))
        value, pdf = self.eval_pdf(wo)
        weight = value * dr.rcp(dr.select(pdf > 0, pdf, 1))
        sampled_type = dr.select(specular, UInt32(BSDFFlags.GlossyReflection), UInt32(BSDFFlags.DiffuseReflection))
        component = dr.select(specular, UInt32(0), UInt32(1))
        return BSDFSample3f.of(wo, pdf, sampled_type, sampled_component=component), weight
