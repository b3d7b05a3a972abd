"""The phase function of each lane."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.core.records import PhaseFunctionContext
from djpt.core.records.interactions import MediumInteraction3f
from djpt.dispatch.ensemble import Detached
from djpt.dispatch.family import Pointer
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32, Vector3f
from djpt.phase.base import PhaseFunction

__all__ = ["PhaseFunctionPtr"]

LEAST = 1e-30
"""The inverse of smaller numbers may overflow."""

Sampled = tuple[Vector3f, Color3f, Float]
"""A direction, its weight and its density."""


class PhaseFunctionPtr(Pointer[PhaseFunction]):
    """The phase function of each lane's medium. Methods as in `djpt.phase.PhaseFunction`.

    Where there is no phase function, results mean nothing.
    """

    def flags(self, active: Bool | bool = True) -> UInt32:
        """The `PhaseFunctionFlags` per lane."""
        return self.number(lambda phase: phase.flags())

    def component_count(self, active: Bool | bool = True) -> UInt32:
        """The number of components per lane."""
        return self.number(lambda phase: phase.component_count())

    def sample(
        self,
        ctx: PhaseFunctionContext,
        mi: MediumInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> Sampled:
        """Sample `wo`, detached, with its density; the weight is 0 on inactive lanes."""
        wo, weight, pdf = self.visit(lambda phase: self._sampled(phase, ctx, mi, sample1, sample2, active))
        return wo, dr.select(active, weight, 0), pdf

    def eval_pdf(
        self, ctx: PhaseFunctionContext, mi: MediumInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        """The value, and the density of `sample` at `wo`; 0 on inactive lanes."""
        value, pdf = self.visit(lambda phase: phase.eval_pdf(ctx, mi, wo, active))
        return dr.select(active, value, 0), dr.select(active, pdf, 0)

    def eval_pdf_sample(
        self,
        ctx: PhaseFunctionContext,
        mi: MediumInteraction3f,
        wo: Vector3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Color3f, Float, Vector3f, Color3f, Float]:
        """The results of `eval_pdf` and `sample` in one dispatch, all but value and weight detached.

        Inactive lanes aren't zeroed: callers mask.
        """

        def method(phase: PhaseFunction) -> tuple[Color3f, Float, Vector3f, Color3f, Float]:
            value, pdf = phase.eval_pdf(ctx, mi, wo, active)
            return value, dr.detach(pdf), *self._sampled(phase, ctx, mi, sample1, sample2, active)

        return self.visit(method, self.branching(active, mi.wi, mi.p, wo))

    def projected_area(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Float:
        """The fraction of the extinction that acts on light from `mi.wi`; 0 on inactive lanes."""
        return dr.select(active, self.visit(lambda phase: phase.projected_area(mi, active)), 0)

    def max_projected_area(self) -> Float:
        """The largest `projected_area` per lane."""
        return self.visit(lambda phase: phase.max_projected_area())

    def visit(self, method: Callable[[PhaseFunction], Any], active: Bool | None = None) -> Any:
        """``method(phase)`` per lane: one dispatch for anything that an estimator asks of phase functions.

        `method` returns a PyTree; on lanes that aren't `active` it means nothing.
        """
        return self.ensemble.call(self.index, self.lookup, method, None, active)

    def _sampled(
        self,
        phase: PhaseFunction,
        ctx: PhaseFunctionContext,
        mi: MediumInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool,
    ) -> Sampled:
        """A detached sample whose weight has the derivative of the value over the density, which is kept constant."""
        wo, weight, pdf = dr.detach(phase.sample(ctx, mi, sample1, sample2, active))
        if isinstance(self.lookup, Detached):
            return wo, weight, pdf
        value, _ = phase.eval_pdf(ctx, mi, wo, active)
        if dr.grad_enabled(value):
            plain = dr.detach(value)
            attached = value * dr.select(dr.abs(plain) > LEAST, weight * dr.rcp(plain), dr.rcp(pdf))
            attached = dr.select(pdf > 0, attached, weight)
            weight = dr.replace_grad(weight, attached)  # type: ignore[func-returns-value, assignment]
        return wo, weight, pdf
