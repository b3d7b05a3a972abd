"""Surfaces with holes."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.kernels import minimum
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import NestingBSDF, derivative_of_choice

__all__ = ["Mask", "rescaled", "unit_interval"]

ALMOST_ONE = 1 - 2.0**-24
"""The largest float below 1."""


class Mask(NestingBSDF):
    """The nested BSDF where the surface is opaque, straight passage where it isn't.

    f = opacity f_nested + (1 - opacity) delta(wo + wi) / abs(cos theta_o).

    Parameters: `opacity` (scalar texture, default 0.5; values are clipped to [0, 1]) and one nested BSDF,
    under any key; its parameters are listed under `nested_bsdf`. The nested BSDF is sampled if the random number
    is below `opacity`, else the ray goes straight on.
    """

    in_any_frame = True
    symmetric = True
    children = ("opacity", "nested_bsdf")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.opacity = props.texture_1("opacity", 0.5)

    def components(self) -> tuple[int, ...]:
        null = int(BSDFFlags.Null | BSDFFlags.FrontSide | BSDFFlags.BackSide)
        return (*self.nested_bsdf.components(), null)

    def _opacity(self, si: SurfaceInteraction3f, active: Bool | bool) -> Float:
        return unit_interval(self.opacity.eval_1(si, active))

    def _choose(
        self, si: SurfaceInteraction3f, sample1: Float, opacity: Float, nested: BSDFSample3f, weight: Color3f
    ) -> tuple[BSDFSample3f, Color3f]:
        """The result of `sample`, given the nested sample."""
        hit = sample1 < opacity
        null = BSDFSample3f.of(
            -si.wi, 1 - opacity, BSDFFlags.Null, sampled_component=self.nested_bsdf.component_count()
        )
        bs: BSDFSample3f = dr.select(hit, nested.replaced(pdf=nested.pdf * opacity), null)
        return bs, dr.select(hit, weight * derivative_of_choice(opacity), derivative_of_choice(1 - opacity))

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        opacity = self._opacity(si, active)
        nested_too, null_too = self._asked(ctx)
        if not null_too:
            bs, weight = self.nested_bsdf.sample(ctx, si, sample1, sample2, active)
            return bs, weight * opacity
        if not nested_too:
            last = self.nested_bsdf.component_count()
            return BSDFSample3f.of(-si.wi, 1, BSDFFlags.Null, sampled_component=last), Color3f(1 - opacity)
        nested = self.nested_bsdf.sample(ctx, si, rescaled(sample1, opacity), sample2, active)
        return self._choose(si, sample1, opacity, *nested)

    def _asked(self, ctx: BSDFContext) -> tuple[bool, bool]:
        """Two flags: True if a context asks for a lobe of the nested BSDF; True if it asks for the way straight on."""
        asked = self.asked(ctx)
        return any(asked[:-1]), asked[-1]

    def eval(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Color3f:
        return self.nested_bsdf.eval(ctx, si, wo, active) * self._opacity(si, active)

    def pdf(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Float:
        pdf = self.nested_bsdf.pdf(ctx, si, wo, active)
        return pdf * self._opacity(si, active) if self._asked(ctx)[1] else pdf

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        opacity = self._opacity(si, active)
        value, pdf = self.nested_bsdf.eval_pdf(ctx, si, wo, active)
        return value * opacity, pdf * opacity if self._asked(ctx)[1] else pdf

    def eval_pdf_sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        wo: Vector3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Color3f, Float, BSDFSample3f, Color3f]:
        if not all(self._asked(ctx)):
            return super().eval_pdf_sample(ctx, si, wo, sample1, sample2, active)
        opacity = self._opacity(si, active)
        value, pdf, nested, weight = self.nested_bsdf.eval_pdf_sample(
            ctx, si, wo, rescaled(sample1, opacity), sample2, active
        )
        bs, weight = self._choose(si, sample1, opacity, nested, weight)
        return value * opacity, pdf * opacity, bs, weight

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        opacity = self._opacity(si, active)
        return 1 - opacity * (1 - self.nested_bsdf.eval_null_transmission(si, active))


def unit_interval(x: Float) -> Float:
    """The number `x` clipped to [0, 1], with the derivative 1 also on the bounds, where optimisers often stand."""
    positive = dr.select(x < 0, Float(0), x)
    return dr.select(positive > 1, Float(1), positive)


def rescaled(sample: Float, probability: Float) -> Float:
    """A fresh uniform random number, made of one that was found to lie below `probability`."""
    return minimum(sample * dr.rcp(dr.select(probability > 0, probability, 1)), Float(ALMOST_ONE))


register_bsdf("mask", Mask)
