"""Per-lane plugins: what `si.bsdf()` and `si.emitter()` return.

A pointer holds an index per lane and forwards each call through the scene's ensembles, so
that scripts written against Mitsuba's `BSDFPtr` and `EmitterPtr` run unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.dispatch.ensemble import Detached, Ensemble, Lookup
from djpt.dispatch.lookup import choose
from djpt.emitters.base import Emitter
from djpt.materials.base import BSDF
from djpt.records import (
    BSDFContext,
    BSDFFlags,
    BSDFSample3f,
    DirectionSample3f,
    EmissionSample,
    Ray3f,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f

__all__ = ["BSDFPtr", "EmitterPtr"]


class BSDFPtr:
    """The BSDF of each lane's surface point. Methods as in `djpt.materials.base.BSDF`."""

    def __init__(self, bsdfs: Ensemble[BSDF], lookup: Lookup, index: UInt32) -> None:
        self._bsdfs, self._lookup, self.index = bsdfs, lookup, index

    def flags(self, index: int | None = None, active: Bool | bool = True) -> UInt32:
        """The `BSDFFlags` per lane; with `index` those of that lobe, 0 where there is none."""
        flags = [flags_of(bsdf, index) for bsdf in self._bsdfs.plugins]
        return choose(self.index, [UInt32(f) for f in flags], flags)

    def component_count(self, active: Bool | bool = True) -> UInt32:
        """The number of lobes per lane."""
        counts = [bsdf.component_count() for bsdf in self._bsdfs.plugins]
        return choose(self.index, [UInt32(n) for n in counts], counts)

    def needs_differentials(self, active: Bool | bool = True) -> Bool:
        """False: no BSDF looks at the rays of neighbouring pixels."""
        return Bool(False)

    def has_attribute(self, name: str, active: Bool | bool = True) -> Bool:
        """Whether the BSDF of each lane has a value of that name."""
        known = [int(bsdf.has_attribute(name)) for bsdf in self._bsdfs.plugins]
        return (choose(self.index, [UInt32(n) for n in known], known) != 0) & active

    def eval_attribute(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The value of that name as a colour; 0 where there is none and on inactive lanes."""
        return self._attribute(lambda bsdf: bsdf.eval_attribute(name, si, active), name, Color3f(0), active)

    def eval_attribute_1(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Float:
        """The value of that name as a number; 0 where there is none and on inactive lanes."""
        return self._attribute(lambda bsdf: bsdf.eval_attribute_1(name, si, active), name, Float(0), active)

    def eval_attribute_3(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The same as `eval_attribute`."""
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

        return self.visit(method, Bool(active))

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The share of light that passes straight through; 0 on inactive lanes."""
        return dr.select(active, self.visit(lambda bsdf: bsdf.eval_null_transmission(si, active)), 0)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The albedo; 0 on inactive lanes."""
        value = self.visit(lambda bsdf: bsdf.eval_diffuse_reflectance(si, active))
        return dr.select(active, value, 0)

    def visit(self, method: Callable[[BSDF], Any], active: Bool | None = None) -> Any:
        """``method(bsdf)`` per lane: one dispatch for anything that an estimator asks of BSDFs.

        `method` returns a PyTree; on lanes that aren't `active` it means nothing.
        """
        # Every surface has a BSDF, so no value is needed for "none".
        return self._bsdfs.call(self.index, self._lookup, method, None, active)

    def _reattached(
        self,
        bsdf: BSDF,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        bs: BSDFSample3f,
        weight: Color3f,
        active: Bool | bool,
    ) -> Color3f:
        """The weight with the derivative that it has if the sampled direction is kept: that of eval / detach(pdf).

        What `sample` computes may have cancelled terms of value and density, and differentiates as if the
        direction moved along. Delta lobes, which `eval` doesn't know, keep the derivative of their weight.
        """
        if isinstance(self._lookup, Detached):
            return weight
        value = bsdf.eval(ctx, si, bs.wo, active)
        if not dr.grad_enabled(weight, value):
            return weight
        fixed, plain = dr.detach(weight), dr.detach(value)
        smooth = dr.select(plain != 0, fixed * value * dr.rcp(plain), fixed)
        change = dr.select(has_flag(bs.sampled_type, BSDFFlags.Delta), weight, smooth)
        return dr.replace_grad(fixed, change)  # type: ignore[func-returns-value, return-value]


def flags_of(bsdf: BSDF, index: int | None) -> int:
    """The flags of a BSDF, or those of a lobe; 0 if it has no such lobe."""
    if index is None:
        return bsdf.flags()
    return bsdf.flags(index) if index < bsdf.component_count() else 0


class EmitterPtr:
    """The emitter of each lane, or none. Methods as in `djpt.emitters.base.Emitter`."""

    def __init__(self, emitters: Ensemble[Emitter], lookup: Lookup, index: UInt32) -> None:
        self._emitters, self._lookup, self.index = emitters, lookup, index

    def is_valid(self) -> Bool:
        """True where there is an emitter."""
        return self.index < len(self._emitters)

    def flags(self) -> UInt32:
        """The `EmitterFlags` per lane; 0 where there is no emitter."""
        flags = [emitter.flags() for emitter in self._emitters.plugins]
        if not flags:
            return UInt32(0)
        return dr.select(self.is_valid(), choose(self.index, [UInt32(f) for f in flags], flags), 0)

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The radiance towards `si.wi`; 0 where there is no emitter and on inactive lanes."""
        value = self._emitters.call(self.index, self._lookup, lambda e: e.eval(si, active), Color3f(0))
        return dr.select(active, value, 0)

    def sample_direction(
        self, ref: SurfaceInteraction3f | Point3f, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """A direction towards the emitter; weight 0 where there is none."""
        p = ref.p if isinstance(ref, SurfaceInteraction3f) else ref
        ds, weight = self._emitters.call(
            self.index, self._lookup, lambda e: e.sample_direction(p, sample, active), None
        )
        ds.emitter_index = self.index
        return ds, dr.select(self.is_valid() & active, weight, 0)

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        """Sample a ray that leaves the emitter; weight 0 where there is none and on inactive lanes."""
        es = self._emitters.call(
            self.index, self._lookup, lambda e: e.sample_emission(position_sample, direction_sample, active), None
        )
        es.weight = dr.select(self.is_valid() & active, es.weight, 0)
        return es

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        """The densities of `sample_emission` by position and direction; 0 where there is no emitter."""
        position, direction = self._emitters.call(
            self.index, self._lookup, lambda e: e.pdf_emission(d, n, uv, active), (Float(0), Float(0))
        )
        return dr.select(active, position, 0), dr.select(active, direction, 0)

    def sample_ray(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f]:
        """Sample a ray that leaves the emitter: ray and weight of `sample_emission`."""
        es = self.sample_emission(position_sample, direction_sample, active)
        return es.ray, es.weight

    def pdf_direction(
        self, ref: SurfaceInteraction3f | Point3f, ds: DirectionSample3f, active: Bool | bool = True
    ) -> Float:
        """The density of `sample_direction`, per unit solid angle; 0 where there is no emitter."""
        p = ref.p if isinstance(ref, SurfaceInteraction3f) else ref
        pdf = self._emitters.call(self.index, self._lookup, lambda e: e.pdf_direction(p, ds, active), Float(0))
        return dr.select(active, pdf, 0)
