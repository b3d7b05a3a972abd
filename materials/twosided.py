"""One-sided BSDFs made two-sided."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import drjit as dr

from djpt.core.records import ALL_COMPONENTS, BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, has_flag
from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.errors import SceneError
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDF

__all__ = ["TwoSided"]

Value = TypeVar("Value", Color3f, Float)

TRANSMITS = BSDFFlags.DiffuseTransmission | BSDFFlags.GlossyTransmission | BSDFFlags.DeltaTransmission | BSDFFlags.Null


class TwoSided(BSDF):
    """The nested BSDF seen from the front; from behind the second one, or the same again.

    Children: one or two BSDFs, front and back, under any key. Behind the surface the z axis
    of the local frame is mirrored. A transmitting BSDF can't be nested.
    """

    in_any_frame = True
    symmetric = True
    children = ("front", "back")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        nested = [plugin for _, plugin in props.children("bsdf")]
        if not 1 <= len(nested) <= 2:
            raise SceneError(f"{props.node}: 'twosided' takes one or two nested BSDFs, found {len(nested)}")
        for bsdf in nested:
            if has_flag(bsdf.flags(), TRANSMITS):
                raise SceneError(f"{props.node}: a transmitting BSDF can't be made two-sided")
        self.front = nested[0]
        # None stands for "the same": the nested BSDF is then traced once, for both sides.
        self.back = nested[1] if len(nested) == 2 else None

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("brdf_0", self.front)
        if self.back is not None:
            callback.put("brdf_1", self.back)

    def has_attribute(self, name: str, active: Bool | bool = True) -> bool:
        return any(bsdf.has_attribute(name) for bsdf in (self.front, self.back) if bsdf is not None)

    def eval_attribute(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The parameter of the BSDF on the side of `si.wi`, 0 if only the other has one; see `BSDF.eval_attribute`."""
        return self._of_side(name, si, lambda bsdf: bsdf.eval_attribute(name, si, active), Color3f(0))

    def eval_attribute_1(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Float:
        return self._of_side(name, si, lambda bsdf: bsdf.eval_attribute_1(name, si, active), Float(0))

    def _of_side(self, name: str, si: SurfaceInteraction3f, value: Callable[[BSDF], Any], nothing: Any) -> Any:
        if not self.has_attribute(name):
            self.front.eval_attribute(name, si)  # which says what is possible
        front, back = (
            value(bsdf) if bsdf.has_attribute(name) else nothing for bsdf in (self.front, self.back or self.front)
        )
        return dr.select(si.wi.z < 0, back, front)

    def components(self) -> tuple[int, ...]:
        back = self.back or self.front
        sides = int(BSDFFlags.FrontSide | BSDFFlags.BackSide)
        return (
            *((lobe & ~sides) | int(BSDFFlags.FrontSide) for lobe in self.front.components()),
            *((lobe & ~sides) | int(BSDFFlags.BackSide) for lobe in back.components()),
        )

    def _seen_from_front(self, si: SurfaceInteraction3f) -> SurfaceInteraction3f:
        wi = Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
        return si.replaced(wi=wi)

    def _only(self, ctx: BSDFContext, behind: Bool) -> tuple[BSDF, BSDFContext, Bool] | None:
        """The BSDF that has the only lobe asked for, its context, and where it is seen; None if all are asked for."""
        if ctx.component == ALL_COMPONENTS:
            return None
        first = self.front.component_count()
        if ctx.component < first:
            return self.front, ctx, ~behind
        return self.back or self.front, ctx.of_part(first), behind

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        behind, mirrored = si.wi.z < 0, self._seen_from_front(si)
        only = self._only(ctx, behind)
        if only is not None:
            bsdf, ctx, here = only
            bs, weight = bsdf.sample(ctx, mirrored, sample1, sample2, active)
            return dr.select(here, (flipped_sample(bs, behind), weight), (BSDFSample3f.none(), Color3f(0)))
        result = self.front.sample(ctx, mirrored, sample1, sample2, active)
        if self.back is not None:
            result = dr.select(behind, self.back.sample(ctx, mirrored, sample1, sample2, active), result)
        bs, weight = result
        return flipped_sample(bs, behind), weight

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        behind, mirrored = si.wi.z < 0, self._seen_from_front(si)
        wo = flipped(wo, behind)
        only = self._only(ctx, behind)
        if only is not None:
            bsdf, ctx, here = only
            return dr.select(here, bsdf.eval_pdf(ctx, mirrored, wo, active), (Color3f(0), Float(0)))
        result = self.front.eval_pdf(ctx, mirrored, wo, active)
        if self.back is not None:
            result = dr.select(behind, self.back.eval_pdf(ctx, mirrored, wo, active), result)
        return result

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
        behind, mirrored = si.wi.z < 0, self._seen_from_front(si)
        wo = flipped(wo, behind)
        result = self.front.eval_pdf_sample(ctx, mirrored, wo, sample1, sample2, active)
        if self.back is not None:
            other = self.back.eval_pdf_sample(ctx, mirrored, wo, sample1, sample2, active)
            result = dr.select(behind, other, result)
        value, pdf, bs, weight = result
        return value, pdf, flipped_sample(bs, behind), weight

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        behind, mirrored = si.wi.z < 0, self._seen_from_front(si)
        result = self.front.eval_diffuse_reflectance(mirrored, active)
        if self.back is not None:
            result = dr.select(behind, self.back.eval_diffuse_reflectance(mirrored, active), result)
        return result


def flipped(v: Vector3f, behind: Bool) -> Vector3f:
    """The direction `v`, mirrored by the surface where `behind`."""
    return Vector3f(v.x, v.y, dr.select(behind, -v.z, v.z))


def flipped_sample(bs: BSDFSample3f, behind: Bool) -> BSDFSample3f:
    """The sample `bs`, mirrored by the surface where `behind`."""
    return bs.replaced(wo=flipped(bs.wo, behind))


register_bsdf("twosided", TwoSided)
