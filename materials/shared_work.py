"""BSDFs whose evaluation and sampling share work: Fresnel terms of `wi`, textures, distributions of facets."""

from __future__ import annotations

from typing import Protocol

from djpt.core.records import BSDFContext, BSDFSample3f, SurfaceInteraction3f
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDF

__all__ = ["BSDFAtPoint", "SharedWorkBSDF"]


class BSDFAtPoint(Protocol):
    """A BSDF at one surface point, seen from one direction: arguments and results as in `BSDF`."""

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        """The value f abs(cos theta_o), and the density of `sample` at `wo`."""

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        """A sampled direction and its weight."""


class SharedWorkBSDF(BSDF):
    """A BSDF with one method to override, `at`, which computes once all that depends on `wi` and the point alone."""

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        """The BSDF at `si`, seen from `si.wi`."""
        raise NotImplementedError

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        if not self.is_asked(ctx):
            return BSDFSample3f.none(), Color3f(0)
        return self.at(ctx, si, active).sample(sample1, sample2)

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        if not self.is_asked(ctx):
            return Color3f(0), Float(0)
        return self.at(ctx, si, active).eval_pdf(wo)

    def eval_pdf_sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        wo: Vector3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Color3f, Float, BSDFSample3f, Color3f]:
        if not self.is_asked(ctx):
            return Color3f(0), Float(0), BSDFSample3f.none(), Color3f(0)
        here = self.at(ctx, si, active)
        return *here.eval_pdf(wo), *here.sample(sample1, sample2)
