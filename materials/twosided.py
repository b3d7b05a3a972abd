"""One-sided BSDFs made two-sided."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.records import ALL_COMPONENTS, BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, has_flag
from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.errors import SceneError
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.materials.base import BSDF, BlackAtPoint, BSDFAtPoint, SharedWorkBSDF

__all__ = ["TwoSided"]

TRANSMITS = BSDFFlags.DiffuseTransmission | BSDFFlags.GlossyTransmission | BSDFFlags.DeltaTransmission | BSDFFlags.Null


class TwoSided(SharedWorkBSDF):
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

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        seen, first = self._seen_from_front(si), self.front.component_count()
        if ctx.component == ALL_COMPONENTS:
            back = None if self.back is None else self.back.at_point(ctx, seen, active)
            return TwoSidedAtPoint(si.wi.z < 0, self.front.at_point(ctx, seen, active), back)
        if ctx.component < first:
            return TwoSidedAtPoint(si.wi.z < 0, self.front.at_point(ctx, seen, active), BlackAtPoint())
        back = (self.back or self.front).at_point(ctx.of_part(first), seen, active)
        return TwoSidedAtPoint(si.wi.z < 0, BlackAtPoint(), back)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        behind, mirrored = si.wi.z < 0, self._seen_from_front(si)
        result = self.front.eval_diffuse_reflectance(mirrored, active)
        if self.back is not None:
            result = dr.select(behind, self.back.eval_diffuse_reflectance(mirrored, active), result)
        return result


@dataclass
class TwoSidedAtPoint:
    """A `TwoSided` at one point, seen from `wi`: the BSDFs of both sides, each as if seen from the front."""

    behind: Bool
    """True where the surface is seen from behind."""
    front: BSDFAtPoint
    back: BSDFAtPoint | None
    """None stands for the same BSDF as in front."""

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        return self._of_side(lambda bsdf: bsdf.eval_pdf(self._flipped(wo)))

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        bs, weight = self._of_side(lambda bsdf: bsdf.sample(sample1, sample2))
        return bs.replaced(wo=self._flipped(bs.wo)), weight

    def _of_side(self, result: Callable[[BSDFAtPoint], Any]) -> Any:
        """The result of the BSDF of the side that is seen."""
        front = result(self.front)
        return front if self.back is None else dr.select(self.behind, result(self.back), front)

    def _flipped(self, v: Vector3f) -> Vector3f:
        """The direction `v`, mirrored by the surface where that is seen from behind."""
        return Vector3f(v.x, v.y, dr.select(self.behind, -v.z, v.z))


register_bsdf("twosided", TwoSided)
