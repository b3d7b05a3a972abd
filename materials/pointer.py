"""The BSDF of each lane: what `si.bsdf()` returns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, has_flag
from djpt.dispatch.ensemble import Detached
from djpt.dispatch.family import Pointer
from djpt.jit.kernels import mapped
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32, Vector3f
from djpt.materials.base import BSDF

__all__ = ["BSDFPtr", "at_fixed_direction"]


class BSDFPtr(Pointer[BSDF]):
    """The BSDF of each lane's surface point. Methods as in `djpt.materials.base.BSDF`."""

    member_kind = "bsdf"

    around: tuple[Float, ...]
    """The index of refraction around the surface, relative to that around the whole scene, or nothing for 1: see
    `djpt.materials.base.BSDF.surrounded_by`."""

    def flags(self, index: int | None = None, active: Bool | bool = True) -> UInt32:
        """The `BSDFFlags` per lane; with `index` those of that lobe, 0 where there is none."""
        return self.number(lambda bsdf: flags_of(bsdf, index))

    def component_count(self, active: Bool | bool = True) -> UInt32:
        """The number of lobes per lane."""
        return self.number(lambda bsdf: bsdf.component_count())

    def needs_differentials(self, active: Bool | bool = True) -> Bool:
        """False: no BSDF looks at the rays of neighbouring pixels."""
        return Bool(False)

    def has_attribute(self, name: str, active: Bool | bool = True) -> Bool:
        """True where the BSDF of each lane has a value of that name."""
        return self.holds(lambda bsdf: bsdf.has_attribute(name)) & active

    def eval_attribute(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The value of that name as a colour; 0 where there is none and on inactive lanes."""
        return self._attribute(lambda bsdf: bsdf.eval_attribute(name, si, active), name, Color3f(0), active)

    def eval_attribute_1(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Float:
        """The value of that name as a number; 0 where there is none and on inactive lanes."""
        return self._attribute(lambda bsdf: bsdf.eval_attribute_1(name, si, active), name, Float(0), active)

    def eval_attribute_3(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The value of `eval_attribute`, a colour."""
        return self.eval_attribute(name, si, active)

    def _attribute(self, method: Callable[[BSDF], Any], name: str, nothing: Any, active: Bool | bool) -> Any:
        value = self.visit(lambda bsdf: method(bsdf) if bsdf.has_attribute(name) else nothing)
        return dr.select(active, value, nothing)

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        """Sample `wo`, detached; the weight is 0 on inactive lanes."""

        def method(bsdf: BSDF) -> tuple[BSDFSample3f, Color3f]:
            bs, weight = bsdf.sample(ctx, si, sample1, sample2, active)
            bs = dr.detach(bs)
            return bs, self._reattached(bsdf, ctx, si, bs, weight, active)

        bs, weight = self.visit(method)
        return bs, dr.select(active, weight, 0)

    def eval(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Color3f:
        """The value f abs(cos theta_o); 0 on inactive lanes."""
        return dr.select(active, self.visit(lambda bsdf: bsdf.eval(ctx, si, wo, active)), 0)

    def pdf(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Float:
        """The density of `sample` at `wo`, per unit solid angle; 0 on inactive lanes."""
        return dr.select(active, self.visit(lambda bsdf: bsdf.pdf(ctx, si, wo, active)), 0)

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        """The results of `eval` and `pdf`, in one dispatch; 0 on inactive lanes."""
        value, pdf = self.visit(lambda bsdf: bsdf.eval_pdf(ctx, si, wo, active))
        return dr.select(active, value, 0), dr.select(active, pdf, 0)

    def eval_pdf_both(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float, Float]:
        """`eval`, `pdf` and the density of the way back, in one dispatch; 0 on inactive lanes."""
        value, pdf, back = self.visit(lambda bsdf: bsdf.eval_pdf_both(ctx, si, wo, active))
        return dr.select(active, value, 0), dr.select(active, pdf, 0), dr.select(active, back, 0)

    def eval_pdf_sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        wo: Vector3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Color3f, Float, BSDFSample3f, Color3f]:
        """The results of `eval_pdf` and `sample` in one dispatch, all but value and weight detached.

        Inactive lanes aren't zeroed: callers mask.
        """

        def method(bsdf: BSDF) -> tuple[Color3f, Float, BSDFSample3f, Color3f]:
            value, pdf, bs, weight = bsdf.eval_pdf_sample(ctx, si, wo, sample1, sample2, active)
            bs = dr.detach(bs)
            return value, dr.detach(pdf), bs, self._reattached(bsdf, ctx, si, bs, weight, active)

        return self.visit(method, self.branching(active, si.wi, si.uv, wo))

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The fraction of light that passes straight through; 0 on inactive lanes."""
        return dr.select(active, self.visit(lambda bsdf: bsdf.eval_null_transmission(si, active)), 0)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The albedo; 0 on inactive lanes."""
        value = self.visit(lambda bsdf: bsdf.eval_diffuse_reflectance(si, active))
        return dr.select(active, value, 0)

    def sh_frame(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Frame3f:
        """The shading frame that the BSDF works in, in world space: where normals are mapped, not that of `si`."""
        if all(type(bsdf).sh_frame is BSDF.sh_frame for bsdf in self.plugins):
            return si.sh_frame
        frame: Frame3f = self.visit(lambda bsdf: bsdf.sh_frame(si, active))
        return frame

    def visit(self, method: Callable[[BSDF], Any], active: Bool | None = None) -> Any:
        """``method(bsdf)`` per lane: one dispatch for anything that an estimator asks of BSDFs.

        `method` returns a PyTree; on lanes that aren't `active` it means nothing. With `active` lanes, BSDFs are
        branches, in which what the method uses must not be attached: `branching` says when.
        """

        def there(bsdf: BSDF) -> Any:
            return method(bsdf.surrounded_by(self.around[0]) if self.around else bsdf)

        result = self.ensemble.call(self.index, self.lookup, there, None, active)
        # Every surface has a BSDF, so no value is needed for "none", unless a script has made the pointers.
        return zero_unless(self.is_valid(), result) if self.is_of_script else result

    def _reattached(
        self,
        bsdf: BSDF,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        bs: BSDFSample3f,
        weight: Color3f,
        active: Bool | bool,
    ) -> Color3f:
        """The weight, `at_fixed_direction` where values may be attached."""
        if isinstance(self.lookup, Detached):
            return weight
        return at_fixed_direction(bs, weight, bsdf.eval(ctx, si, bs.wo, active))


def at_fixed_direction(bs: BSDFSample3f, weight: Color3f, value: Color3f) -> Color3f:
    """The weight of a sample with the derivative that it has if the direction is kept: that of value / detach(pdf).

    What `BSDF.sample` computes may have cancelled terms of value and density, and differentiates as if the direction
    moved along; `value` is that of the BSDF at the sampled direction. Where it is 0, no ratio shows the density: that
    of the sample is taken. Delta lobes, which have no value, keep the derivative of their weight.
    """
    if not dr.grad_enabled(weight, value):
        return weight
    fixed, plain = dr.detach(weight), dr.detach(value)
    smooth = value * dr.select(dr.abs(plain) > LEAST, fixed * dr.rcp(plain), dr.rcp(bs.pdf))
    smooth = dr.select(bs.pdf > 0, smooth, fixed)
    change = dr.select(has_flag(bs.sampled_type, BSDFFlags.Delta), weight, smooth)
    return dr.replace_grad(fixed, change)  # type: ignore[func-returns-value, return-value]


LEAST = 1e-30
"""The inverse of smaller numbers may overflow."""


def flags_of(bsdf: BSDF, index: int | None) -> int:
    """The flags of a BSDF, or those of a lobe; 0 if it has no such lobe."""
    if index is None:
        return bsdf.flags()
    return bsdf.flags(index) if index < bsdf.component_count() else 0


def zero_unless(valid: Bool, result: Any) -> Any:
    """The records, arrays and tuples `result` where they mean something, else zeros."""
    return dr.select(valid, result, mapped(result, lambda numbers: dr.zeros(type(numbers))))
