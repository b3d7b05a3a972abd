"""The phase function of Henyey and Greenstein."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import drjit as dr

from djpt.core.numeric import as_number
from djpt.core.records import PhaseFunctionContext, PhaseFunctionFlags
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_phase
from djpt.errors import ParameterError
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.phase.base import PhaseFunction, around

__all__ = ["HGPhaseFunction"]

TINY = 2.0**-24
"""Mitsuba takes smaller asymmetries for none, and mirrors what it samples."""


class HGPhaseFunction(PhaseFunction):
    """f = (1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^(3/2)), where cos is that of the angle by which light is turned.

    Parameters: `g` in (-1, 1), the mean of the cosine (default 0.8): scattering is mostly forward if it is positive,
    mostly backward if it is negative, and isotropic at 0.

    L. G. Henyey and J. L. Greenstein, "Diffuse radiation in the galaxy", Astrophysical Journal 93, 1941.
    """

    in_any_frame = True
    m_flags = int(PhaseFunctionFlags.Anisotropic)
    values: ClassVar[Mapping[str, ParamFlags]] = {"g": ParamFlags.Differentiable | ParamFlags.Discontinuous}

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.g = as_float(props.float("g", 0.8, low=-1.0, high=1.0, low_open=True, high_open=True))

    def check_parameter(self, name: str, value: Any) -> Any:
        jit = dr.is_array_v(value) and dr.is_jit_v(value)
        if not recording() and not -1 < (number := as_number(dr.detach(value) if jit else value)) < 1:
            raise ParameterError(f"must lie in (-1, 1), found {number:.9g}")
        return Float(value)

    def sample(
        self,
        ctx: PhaseFunctionContext,
        mi: MediumInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Vector3f, Color3f, Float]:
        # The inverse of the distribution function, with g divided out: it has no pole at g = 0.
        g, x = self.g, dr.fma(2, sample2.x, -1)
        square = dr.square(g)
        inverse = dr.fma(g, x, 1)
        cosine = dr.fma(dr.fma(square, dr.fma(g, dr.fma(x, x, -1), 2 * x), g * dr.fma(x, x, 3)), 0.5, x)
        forward = cosine * dr.square(dr.rcp(inverse))
        forward = dr.select(dr.abs(g) < TINY, -x, forward)
        # 1 + g^2 - 2 g cos is the square of (1 - g^2) / (1 + g x).
        pdf = (1 / (4 * math.pi)) * dr.rcp(dr.square(1 - square)) * (inverse * dr.square(inverse))
        return around(mi, -forward, sample2.y), Color3f(1), pdf

    def eval_pdf(
        self, ctx: PhaseFunctionContext, mi: MediumInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        square = dr.square(self.g)
        base = dr.fma(2 * self.g, dr.dot(wo, mi.wi), 1 + square)
        root = dr.rsqrt(base)
        pdf = (1 / (4 * math.pi)) * (1 - square) * (root * dr.square(root))
        return Color3f(pdf), pdf


register_phase("hg", HGPhaseFunction)
