"""A diffuse base under rough facets, at one point: what `roughplastic` and `pplastic` have in common."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import BSDFFlags, BSDFSample3f
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32, Vector3f
from djpt.materials.fresnel import reflect
from djpt.materials.microfacet import MicrofacetDistribution

__all__ = ["RoughCoatAtPoint"]


class RoughCoatAtPoint:
    """Samples one of two lobes, facets (component 0) or base (component 1), by a probability that is known before."""

    wi: Vector3f
    surface: MicrofacetDistribution
    g1_i: Float
    """G1(wi) over the cosine of `wi`."""
    p_specular: Float
    """The probability of the facets."""

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        """The value of both lobes, f cos theta_o, and the density of `sample`."""
        raise NotImplementedError

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
