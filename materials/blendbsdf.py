"""Mixtures of two materials."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import ALL_COMPONENTS, BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, has_flag
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDF, derivative_of_choice, nested_bsdfs
from djpt.materials.mask import rescaled, unit_interval

__all__ = ["BlendBSDF"]

Sampled = tuple[BSDFSample3f, Color3f]
"""The result of `sample`: the sample and its weight."""


class BlendBSDF(BSDF):
    """f = (1 - weight) f_0 + weight f_1.

    Parameters: `weight` (scalar texture, default 0.5; values are clipped to [0, 1]) and two nested BSDFs, under
    any keys, in the order of the description; their parameters are listed under `bsdf_0` and `bsdf_1`.

    One nested BSDF is sampled, the second if the random number is at most `weight`. A smooth sample is then
    weighted with value and density of the mixture (E. Veach, "Robust Monte Carlo Methods for Light Transport
    Simulation", 1997, 9.2.4: the one-sample model). A delta lobe has no density to be mixed with: it keeps its
    weight, and its probability is multiplied by that of its BSDF. (Mitsuba 3.9 adds densities to such
    probabilities: its mixtures of smooth and perfectly specular BSDFs lose energy.)

    A body whose surface is a blend absorbs what each of the two would absorb.
    """

    in_any_frame = True
    symmetric = True
    children = ("weight", "bsdf_0", "bsdf_1")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.weight = props.texture_1("weight", 0.5)
        self.bsdf_0: BSDF
        self.bsdf_1: BSDF
        self.bsdf_0, self.bsdf_1 = nested_bsdfs(props, 2)
        self.absorbs = self.bsdf_0.absorbs or self.bsdf_1.absorbs

    def components(self) -> tuple[int, ...]:
        return self.bsdf_0.components() + self.bsdf_1.components()

    def _weight(self, si: SurfaceInteraction3f, active: Bool | bool) -> Float:
        return unit_interval(self.weight.eval_1(si, active))

    def _only(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool
    ) -> tuple[BSDF, BSDFContext, Float] | None:
        """The nested BSDF that has the only lobe asked for, its context and its fraction; None if lobes of both are."""
        if ctx.component == ALL_COMPONENTS:
            return None
        weight, first = self._weight(si, active), self.bsdf_0.component_count()
        if ctx.component < first:
            return self.bsdf_0, ctx, 1 - weight
        return self.bsdf_1, ctx.of_part(first), weight

    def _choose(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        weight: Float,
        first: Sampled,
        second: Sampled,
        active: Bool | bool,
    ) -> Sampled:
        """The result of `sample`, given samples of both BSDFs."""
        is_second = (sample1 <= weight) & (weight > 0)
        bs, value = dr.select(is_second, second, first)
        share = dr.select(is_second, weight, 1 - weight)
        pdf, ratio = share * bs.pdf, value * derivative_of_choice(share)
        if has_flag(self.flags(), BSDFFlags.Smooth):
            # The other BSDF would have found this direction, too.
            of_first, of_second = (bsdf.eval_pdf(ctx, si, bs.wo, active) for bsdf in (self.bsdf_0, self.bsdf_1))
            other_value, other_pdf = dr.select(is_second, of_first, of_second)
            mixed_pdf = dr.fma(1 - share, other_pdf, pdf)
            mixed = (value * pdf + other_value * (1 - share)) * dr.rcp(dr.select(mixed_pdf > 0, mixed_pdf, 1))
            delta = has_flag(bs.sampled_type, BSDFFlags.Delta)
            ratio = dr.select(delta, ratio, dr.select(bs.pdf > 0, mixed, 0))
            pdf = dr.select(delta | (bs.pdf <= 0), pdf, mixed_pdf)
        return bs.replaced(pdf=pdf), ratio

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> Sampled:
        only = self._only(ctx, si, active)
        if only is not None:
            bsdf, ctx, share = only
            bs, value = bsdf.sample(ctx, si, sample1, sample2, active)
            return bs, value * share
        weight = self._weight(si, active)
        first = self.bsdf_0.sample(ctx, si, rescaled(sample1 - weight, 1 - weight), sample2, active)
        second = self.bsdf_1.sample(ctx, si, rescaled(sample1, weight), sample2, active)
        return self._choose(ctx, si, sample1, weight, first, second, active)

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        only = self._only(ctx, si, active)
        if only is not None:
            bsdf, ctx, share = only
            value, pdf = bsdf.eval_pdf(ctx, si, wo, active)
            return value * share, pdf
        weight = self._weight(si, active)
        value_0, pdf_0 = self.bsdf_0.eval_pdf(ctx, si, wo, active)
        value_1, pdf_1 = self.bsdf_1.eval_pdf(ctx, si, wo, active)
        return dr.lerp(value_0, value_1, weight), dr.lerp(pdf_0, pdf_1, weight)

    def eval_pdf_sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        wo: Vector3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Color3f, Float, BSDFSample3f, Color3f]:
        if ctx.component != ALL_COMPONENTS:
            return super().eval_pdf_sample(ctx, si, wo, sample1, sample2, active)
        weight = self._weight(si, active)
        sample_0, sample_1 = rescaled(sample1 - weight, 1 - weight), rescaled(sample1, weight)
        value_0, pdf_0, bs_0, weight_0 = self.bsdf_0.eval_pdf_sample(ctx, si, wo, sample_0, sample2, active)
        value_1, pdf_1, bs_1, weight_1 = self.bsdf_1.eval_pdf_sample(ctx, si, wo, sample_1, sample2, active)
        bs, ratio = self._choose(ctx, si, sample1, weight, (bs_0, weight_0), (bs_1, weight_1), active)
        return dr.lerp(value_0, value_1, weight), dr.lerp(pdf_0, pdf_1, weight), bs, ratio

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        first, second = (bsdf.eval_null_transmission(si, active) for bsdf in (self.bsdf_0, self.bsdf_1))
        return dr.lerp(first, second, self._weight(si, active))

    def transmittance(self, distance: Float) -> Color3f:
        return self.bsdf_0.transmittance(distance) * self.bsdf_1.transmittance(distance)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        first, second = (bsdf.eval_diffuse_reflectance(si, active) for bsdf in (self.bsdf_0, self.bsdf_1))
        return dr.lerp(first, second, self._weight(si, active))


register_bsdf("blendbsdf", BlendBSDF)
