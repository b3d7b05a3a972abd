"""Surfaces with holes."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.kernels import minimum
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDFAtPoint, NestingBSDF, derivative_of_choice

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

    def opacity_at(self, si: SurfaceInteraction3f, active: Bool | bool) -> Float:
        """The opacity in [0, 1]."""
        return unit_interval(self.opacity.eval_1(si, active))

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return MaskAtPoint(self, ctx, si, active)

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        opacity = self.opacity_at(si, active)
        return 1 - opacity * (1 - self.nested_bsdf.eval_null_transmission(si, active))


class MaskAtPoint:
    """A `Mask` at one point, seen from `wi`: the work that evaluation and sampling share."""

    def __init__(self, bsdf: Mask, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> None:
        *of_nested, self.passes = bsdf.asked(ctx)
        self.scatters, self.last = any(of_nested), len(of_nested)
        self.opacity, self.wi = bsdf.opacity_at(si, active), si.wi
        self.nested = bsdf.nested_bsdf.at_point(ctx, si, active)

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        value, pdf = self.nested.eval_pdf(wo)
        return value * self.opacity, pdf * self.opacity if self.passes else pdf

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        opacity = self.opacity
        if not self.passes:
            bs, weight = self.nested.sample(sample1, sample2)
            return bs, weight * opacity
        if not self.scatters:
            return BSDFSample3f.of(-self.wi, 1, BSDFFlags.Null, sampled_component=self.last), Color3f(1 - opacity)
        nested, weight = self.nested.sample(rescaled(sample1, opacity), sample2)
        hit = sample1 < opacity
        null = BSDFSample3f.of(-self.wi, 1 - opacity, BSDFFlags.Null, sampled_component=self.last)
        bs = dr.select(hit, nested.replaced(pdf=nested.pdf * opacity), null)
        return bs, dr.select(hit, weight * derivative_of_choice(opacity), derivative_of_choice(1 - opacity))


def unit_interval(x: Float) -> Float:
    """The number `x` clipped to [0, 1], with the derivative 1 also on the bounds, where optimisers often stand."""
    positive = dr.select(x < 0, Float(0), x)
    return dr.select(positive > 1, Float(1), positive)


def rescaled(sample: Float, probability: Float) -> Float:
    """A fresh uniform random number, made of one that was found to lie below `probability`."""
    return minimum(sample * dr.rcp(dr.select(probability > 0, probability, 1)), Float(ALMOST_ONE))


register_bsdf("mask", Mask)
