"""Scattering by molecules."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import drjit as dr

from djpt.core.records import PhaseFunctionContext, PhaseFunctionFlags
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.registry import register_phase
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.phase.base import PhaseFunction, around

__all__ = ["RayleighPhaseFunction"]


class RayleighPhaseFunction(PhaseFunction):
    """f = 3 (1 + cos^2) / (16 pi): unpolarised light at particles much smaller than its wavelength. No parameters.

    J. W. Strutt (Lord Rayleigh), "On the light from the sky, its polarization and colour", Philosophical Magazine 41,
    1871; sampled as by J. R. Frisvad, "Importance sampling the Rayleigh phase function", JOSA A 28(12), 2011.
    """

    in_any_frame = True
    m_flags = int(PhaseFunctionFlags.Anisotropic)
    statics: ClassVar[Sequence[str]] = ()

    def sample(
        self,
        ctx: PhaseFunctionContext,
        mi: MediumInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Vector3f, Color3f, Float]:
        # The real root of cos^3 + 3 cos = 8 u - 4, by Cardano's formula. The roots of z + sqrt(z^2 + 1) and of
        # z - sqrt(z^2 + 1) are each other's negative reciprocals: the one without cancellation is taken.
        z = dr.fma(4, sample2.x, -2)
        root = dr.cbrt(dr.abs(z) + dr.sqrt(dr.fma(z, z, 1)))
        cosine = dr.mulsign(root - dr.rcp(root), z)
        return around(mi, cosine, sample2.y), Color3f(1), density(cosine)

    def eval_pdf(
        self, ctx: PhaseFunctionContext, mi: MediumInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        pdf = density(dr.dot(wo, mi.wi))
        return Color3f(pdf), pdf


def density(cosine: Float) -> Float:
    """The phase function by the cosine of the angle between the directions."""
    scale = 3 / (16 * math.pi)
    return dr.fma(cosine * scale, cosine, scale)


register_phase("rayleigh", RayleighPhaseFunction)
