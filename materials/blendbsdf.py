"""Mixtures of two materials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr

from djpt.core.records import ALL_COMPONENTS, BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, has_flag
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDF, BSDFAtPoint, SharedWorkBSDF, derivative_of_choice, nested_bsdfs
from djpt.materials.mask import rescaled, unit_interval

__all__ = ["BlendBSDF"]


class BlendBSDF(SharedWorkBSDF):
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

    def weight_at(self, si: SurfaceInteraction3f, active: Bool | bool) -> Float:
        """The weight in [0, 1]."""
        return unit_interval(self.weight.eval_1(si, active))

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        weight, first = self.weight_at(si, active), self.bsdf_0.component_count()
        if ctx.component == ALL_COMPONENTS:
            parts = [bsdf.at_point(ctx, si, active) for bsdf in (self.bsdf_0, self.bsdf_1)]
            return BlendAtPoint(parts, weight, has_flag(self.flags(), BSDFFlags.Smooth))
        if ctx.component < first:
            return PartAtPoint(self.bsdf_0.at_point(ctx, si, active), 1 - weight)
        return PartAtPoint(self.bsdf_1.at_point(ctx.of_part(first), si, active), weight)

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        first, second = (bsdf.eval_null_transmission(si, active) for bsdf in (self.bsdf_0, self.bsdf_1))
        return dr.lerp(first, second, self.weight_at(si, active))

    def transmittance(self, distance: Float) -> Color3f:
        return self.bsdf_0.transmittance(distance) * self.bsdf_1.transmittance(distance)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        first, second = (bsdf.eval_diffuse_reflectance(si, active) for bsdf in (self.bsdf_0, self.bsdf_1))
        return dr.lerp(first, second, self.weight_at(si, active))


@dataclass
class PartAtPoint:
    """The one nested BSDF that has the only lobe asked for, with its fraction of the mixture."""

    part: BSDFAtPoint
    share: Float

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        value, pdf = self.part.eval_pdf(wo)
        return value * self.share, pdf

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        bs, value = self.part.sample(sample1, sample2)
        return bs, value * self.share


@dataclass
class BlendAtPoint:
    """Both nested BSDFs at one point, seen from `wi`, and the weight of the second."""

    parts: Sequence[BSDFAtPoint]
    weight: Float
    smooth: bool
    """True if one of them has lobes with a density."""

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        (value_0, pdf_0), (value_1, pdf_1) = (part.eval_pdf(wo) for part in self.parts)
        return dr.lerp(value_0, value_1, self.weight), dr.lerp(pdf_0, pdf_1, self.weight)

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        weight = self.weight
        first = self.parts[0].sample(rescaled(sample1 - weight, 1 - weight), sample2)
        second = self.parts[1].sample(rescaled(sample1, weight), sample2)
        is_second = (sample1 <= weight) & (weight > 0)
        bs, value = dr.select(is_second, second, first)
        share = dr.select(is_second, weight, 1 - weight)
        pdf, ratio = share * bs.pdf, value * derivative_of_choice(share)
        if self.smooth:
            # The other BSDF would have found this direction, too.
            of_first, of_second = (part.eval_pdf(bs.wo) for part in self.parts)
            other_value, other_pdf = dr.select(is_second, of_first, of_second)
            mixed_pdf = dr.fma(1 - share, other_pdf, pdf)
            mixed = (value * pdf + other_value * (1 - share)) * dr.rcp(dr.select(mixed_pdf > 0, mixed_pdf, 1))
            delta = has_flag(bs.sampled_type, BSDFFlags.Delta)
            ratio = dr.select(delta, ratio, dr.select(bs.pdf > 0, mixed, 0))
            pdf = dr.select(delta | (bs.pdf <= 0), pdf, mixed_pdf)
        return bs.replaced(pdf=pdf), ratio


register_bsdf("blendbsdf", BlendBSDF)
