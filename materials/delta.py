"""BSDFs that scatter into single directions only."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import BSDFContext, SurfaceInteraction3f
from djpt.jit.types import Bool, Color3f, Float, Vector3f
from djpt.materials.base import BSDF

__all__ = ["DeltaBSDF", "derivative_of_choice"]


class DeltaBSDF(BSDF):
    """A BSDF whose lobes are all delta distributions: only `sample` finds their directions, `eval` and `pdf` are 0."""

    def eval(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Color3f:
        return Color3f(0)

    def pdf(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Float:
        return Float(0)


def derivative_of_choice(probability: Float) -> Float:
    """The number 1 with the derivative of `probability` / detach(`probability`).

    A factor of the weight of a lobe that was chosen with this probability because it carries this fraction of the
    light: the choice isn't differentiated, the fraction must be.
    """
    if not dr.grad_enabled(probability):
        return Float(1)
    share = probability * dr.rcp(dr.select(probability > 0, dr.detach(probability), 1))
    return dr.replace_grad(Float(1), share)  # type: ignore[func-returns-value, return-value]
