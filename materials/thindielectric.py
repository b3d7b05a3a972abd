"""A pane of glass."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.materials.base import DeltaBSDF, derivative_of_choice
from djpt.materials.dielectric import optional_texture, tint
from djpt.materials.fresnel import fresnel, reflect
from djpt.materials.ior import ETA, ior

__all__ = ["ThinDielectric"]


class ThinDielectric(DeltaBSDF):
    """A dielectric sheet too thin to displace light: mirror reflection, or straight on (a `Null` lobe).

    Light is reflected to and fro within the sheet: with F for one interface, F + (1-F)^2 F (1 + F^2 + F^4 ..)
    = 2 F / (1 + F) comes back, the rest passes.

    Parameters: `int_ior`, `ext_ior`, `specular_reflectance`, `specular_transmittance` as in `dielectric`. The quotient
    `eta` is differentiable here: it changes how much passes, not where to.
    """

    in_any_frame = True
    symmetric = True
    values: ClassVar[Mapping[str, ParamFlags]] = {"eta": ParamFlags.Differentiable | ParamFlags.Discontinuous}
    allowed = ETA
    children = ("specular_reflectance", "specular_transmittance")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.eta = as_float(ior(props, "int_ior", "bk7") / ior(props, "ext_ior", "air"))
        self.specular_reflectance = optional_texture(props, "specular_reflectance")
        self.specular_transmittance = optional_texture(props, "specular_transmittance")

    def components(self) -> tuple[int, ...]:
        sides = BSDFFlags.FrontSide | BSDFFlags.BackSide
        return int(BSDFFlags.DeltaReflection | sides), int(BSDFFlags.Null | sides)

    def reflectance_at(self, si: SurfaceInteraction3f) -> Float:
        """The reflectance of the sheet, 2 F / (1 + F)."""
        single = fresnel(dr.abs(si.wi.z), self.eta)[0]
        return 2 * single * dr.rcp(1 + single)

    def bounce(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, sample1: Float, active: Bool | bool
    ) -> tuple[BSDFSample3f, Color3f]:
        reflects, transmits = self.asked(ctx)
        share = self.reflectance_at(si)
        # One lobe alone is always chosen.
        chosen = sample1 < share if reflects and transmits else Bool(reflects)  # as in `Dielectric`
        part = dr.select(chosen, share, 1 - share)
        pdf = part if reflects and transmits else Float(1)
        wo = dr.select(chosen, reflect(si.wi), -si.wi)
        kind = dr.select(chosen, UInt32(BSDFFlags.DeltaReflection), UInt32(BSDFFlags.Null))
        component = dr.select(chosen, UInt32(0), UInt32(1))
        colour = dr.select(
            chosen, tint(self.specular_reflectance, si, active), tint(self.specular_transmittance, si, active)
        )
        bs = BSDFSample3f.of(wo, dr.detach(pdf), kind, sampled_component=component)
        return bs, colour * (derivative_of_choice(part) if reflects and transmits else part)

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return tint(self.specular_transmittance, si, active) * (1 - self.reflectance_at(si))


register_bsdf("thindielectric", ThinDielectric)
