"""Invisible surfaces."""

from __future__ import annotations

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.description.registry import register_bsdf
from djpt.jit.types import Bool, Color3f, Float
from djpt.materials.base import DeltaBSDF

__all__ = ["Null"]


class Null(DeltaBSDF):
    """A surface that all light passes straight through: wo = -wi, weight 1. No parameters.

    Such a surface can still carry an emitter.
    """

    in_any_frame = True
    invisible = True
    symmetric = True
    bounds_bodies = True

    def components(self) -> tuple[int, ...]:
        return (int(BSDFFlags.Null | BSDFFlags.FrontSide | BSDFFlags.BackSide),)

    def bounce(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, sample1: Float, active: Bool | bool
    ) -> tuple[BSDFSample3f, Color3f]:
        return BSDFSample3f.of(-si.wi, 1, BSDFFlags.Null), Color3f(1)

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return Color3f(1)


register_bsdf("null", Null)
