"""Mixtures of two phase functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import drjit as dr

from djpt.core.records import ALL_COMPONENTS, PhaseFunctionContext
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_phase
from djpt.errors import SceneError
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.phase.base import PhaseFunction
from djpt.volumes.base import Volume

__all__ = ["BlendPhaseFunction"]


class BlendPhaseFunction(PhaseFunction):
    """f = (1 - weight) f_0 + weight f_1.

    Parameters: `weight` (number or volume, default 0.5; values are clipped to [0, 1]) and two nested phase functions,
    under any keys, in the order of the description; their parameters are listed under `phase_0` and `phase_1`.

    One of them is sampled, the second if the random number is at most `weight`, and the sample is weighted with value
    and density of the mixture (E. Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, 9.2.4: the
    one-sample model). A context that asks for one component gets its fraction of the mixture.
    """

    in_any_frame = True
    children: ClassVar[Sequence[str]] = ("weight", "phase_0", "phase_1")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.weight: Volume = props.volume("weight", 0.5)
        nested = [plugin for _, plugin in props.children("phase")]
        if len(nested) != 2:
            raise SceneError(f"{props.node}: 'blendphase' takes two nested phase functions, found {len(nested)}")
        self.phase_0: PhaseFunction
        self.phase_1: PhaseFunction
        self.phase_0, self.phase_1 = nested

    def components(self) -> tuple[int, ...]:
        return self.phase_0.components() + self.phase_1.components()

    def _weight(self, mi: MediumInteraction3f, active: Bool | bool) -> Float:
        return dr.clip(self.weight.eval_1(mi, active), 0, 1)

    def _part(
        self, ctx: PhaseFunctionContext, mi: MediumInteraction3f, active: Bool | bool
    ) -> tuple[PhaseFunction, PhaseFunctionContext, Float]:
        """The nested phase function that has the component asked for, its context and its fraction."""
        weight, first = self._weight(mi, active), self.phase_0.component_count()
        if ctx.component < first:
            return self.phase_0, ctx, 1 - weight
        return self.phase_1, ctx.of_part(first), weight

    def sample(
        self,
        ctx: PhaseFunctionContext,
        mi: MediumInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Vector3f, Color3f, Float]:
        if ctx.component != ALL_COMPONENTS:
            phase, ctx, share = self._part(ctx, mi, active)
            wo, value, pdf = phase.sample(ctx, mi, sample1, sample2, active)
            return wo, value * share, pdf * share
        weight = self._weight(mi, active)
        is_second = sample1 <= weight
        # What is left of the number is uniform again.
        rest = dr.select(is_second, sample1, sample1 - weight) * inverse(dr.select(is_second, weight, 1 - weight))
        first = self.phase_0.sample(ctx, mi, rest, sample2, active)
        second = self.phase_1.sample(ctx, mi, rest, sample2, active)
        wo, value, pdf = dr.select(is_second, second, first)
        # The other one would have found this direction, too.
        other_value, other_pdf = dr.select(
            is_second, self.phase_0.eval_pdf(ctx, mi, wo, active), self.phase_1.eval_pdf(ctx, mi, wo, active)
        )
        share = dr.select(is_second, weight, 1 - weight)
        mixed_pdf = dr.lerp(other_pdf, pdf, share)
        return wo, dr.lerp(other_value, value * pdf, share) * inverse(mixed_pdf), mixed_pdf

    def eval_pdf(
        self, ctx: PhaseFunctionContext, mi: MediumInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        if ctx.component != ALL_COMPONENTS:
            phase, ctx, share = self._part(ctx, mi, active)
            value, pdf = phase.eval_pdf(ctx, mi, wo, active)
            return value * share, pdf * share
        weight = self._weight(mi, active)
        value_0, pdf_0 = self.phase_0.eval_pdf(ctx, mi, wo, active)
        value_1, pdf_1 = self.phase_1.eval_pdf(ctx, mi, wo, active)
        return dr.lerp(value_0, value_1, weight), dr.lerp(pdf_0, pdf_1, weight)

    def projected_area(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Float:
        first, second = (phase.projected_area(mi, active) for phase in (self.phase_0, self.phase_1))
        return dr.lerp(first, second, self._weight(mi, active))

    def max_projected_area(self) -> Float:
        return dr.maximum(self.phase_0.max_projected_area(), self.phase_1.max_projected_area())


def inverse(x: Float) -> Float:
    """The inverse of a number, 0 of 0."""
    return dr.select(x > 0, dr.rcp(x), 0)


register_phase("blendphase", BlendPhaseFunction)
