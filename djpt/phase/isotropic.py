"""Scattering to all directions alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

from djpt.core.records import PhaseFunctionContext, PhaseFunctionFlags
from djpt.core.records.interactions import MediumInteraction3f
from djpt.core.warp import square_to_uniform_sphere
from djpt.description.registry import register_phase
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.phase.base import PhaseFunction

__all__ = ["IsotropicPhaseFunction"]

DENSITY = 1 / (4 * math.pi)


class IsotropicPhaseFunction(PhaseFunction):
    """f = 1 / (4 pi): light that is scattered has forgotten where it came from. No parameters."""

    in_any_frame = True
    m_flags = int(PhaseFunctionFlags.Isotropic)
    statics: ClassVar[Sequence[str]] = ()

    def sample(
        self,
        ctx: PhaseFunctionContext,
        mi: MediumInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Vector3f, Color3f, Float]:
        return square_to_uniform_sphere(sample2), Color3f(1), Float(DENSITY)

    def eval_pdf(
        self, ctx: PhaseFunctionContext, mi: MediumInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        return Color3f(DENSITY), Float(DENSITY)


register_phase("isotropic", IsotropicPhaseFunction)
