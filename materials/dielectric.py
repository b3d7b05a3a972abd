"""A smooth interface of two transparent media."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, TransportMode
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float
from djpt.materials.base import DeltaBSDF, derivative_of_choice
from djpt.materials.fresnel import fresnel, reflect, refract
from djpt.materials.ior import ETA, ior
from djpt.textures.base import Texture

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["REFLECTION", "TRANSMISSION", "Dielectric", "optional_texture", "tint"]

REFLECTION = int(BSDFFlags.DeltaReflection | BSDFFlags.FrontSide | BSDFFlags.BackSide)
TRANSMISSION = int(
    BSDFFlags.DeltaTransmission | BSDFFlags.FrontSide | BSDFFlags.BackSide | BSDFFlags.NonSymmetric  # by eta_ti^2
)


class Dielectric(DeltaBSDF):
    """Mirror reflection with probability F, the Fresnel reflectance, else refraction; from both sides.

    Radiance that is refracted carries the factor eta_ti^2: it is squeezed into a smaller cone in the denser medium.

    Parameters:
        int_ior, ext_ior: index of refraction behind and in front of the surface (> 0, or a name of
            `djpt.materials.ior.IOR`; defaults `bk7`, `air`). As a parameter their quotient, `eta`: not differentiable,
            since it bends paths.
        specular_reflectance, specular_transmittance: factors for the two lobes (textures in [0, 1]; default: none),
            which real glass doesn't have.
        absorption: of the medium behind the surface, per unit length (number or rgb, >= 0; default: none). The
            transmittance of a segment of length d is exp(-absorption d): Beer's law.
    """

    symmetric = True
    bounds_bodies = True
    values: ClassVar[Mapping[str, ParamFlags]] = {"eta": ParamFlags.NonDifferentiable}
    allowed = ETA
    children = ("specular_reflectance", "specular_transmittance", "absorption")
    statics: ClassVar[Sequence[str]] = ("absorbs",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.eta = as_float(ior(props, "int_ior", "bk7") / ior(props, "ext_ior", "air"))
        self.specular_reflectance = optional_texture(props, "specular_reflectance")
        self.specular_transmittance = optional_texture(props, "specular_transmittance")
        self.absorbs = "absorption" in props
        self.absorption = props.texture("absorption", low=0.0) if self.absorbs else None
        if self.absorption is not None and not self.absorption.is_constant:
            raise props.error("absorption", "must be a number or an rgb colour: it fills a body, not a surface")

    def move_into(self, frame: Frame) -> None:
        self.move_nested(frame)
        self.absorption = frame.rescaled(self.absorption, -1)

    def surrounded_by(self, index: Float) -> Dielectric:
        view = copy.copy(self)
        view.eta = self.eta / index
        return view

    def components(self) -> tuple[int, ...]:
        return REFLECTION, TRANSMISSION

    def interface(self, cos_theta_i: Float) -> tuple[Float, Float, Float, Float]:
        """The results of `fresnel` for this interface."""
        return fresnel(cos_theta_i, self.eta)

    def bounce(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, sample1: Float, active: Bool | bool
    ) -> tuple[BSDFSample3f, Color3f]:
        (bs_r, weight_r), (bs_t, weight_t), share = self.lobes(ctx, si, active)
        asked = [lobe for lobe, wanted in zip(self.components(), self.asked(ctx), strict=True) if wanted]
        if len(asked) == 1:
            # One lobe alone is always chosen, with its fraction of the whole as weight.
            return (bs_r, weight_r * share) if asked == [REFLECTION] else (bs_t, weight_t * (1 - share))
        # Not <=: what reflects nothing mustn't be chosen even if the sample is 0.
        chosen = sample1 < share
        bs_r.pdf, bs_t.pdf = share, 1 - share
        weight_r, weight_t = weight_r * derivative_of_choice(share), weight_t * derivative_of_choice(1 - share)
        return dr.select(chosen, bs_r, bs_t), dr.select(chosen, weight_r, weight_t)

    def lobes(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool
    ) -> tuple[tuple[BSDFSample3f, Color3f], tuple[BSDFSample3f, Color3f], Float]:
        """The reflected and the transmitted direction (pdf 1), each with its tint, and the reflectance F."""
        reflectance, cos_theta_t, eta_it, eta_ti = self.interface(si.wi.z)
        bs_r = BSDFSample3f.of(reflect(si.wi), 1, BSDFFlags.DeltaReflection)
        wo_t = refract(si.wi, None, cos_theta_t, eta_ti)
        bs_t = BSDFSample3f.of(wo_t, 1, BSDFFlags.DeltaTransmission, eta=eta_it, sampled_component=1)
        tint_r = tint(self.specular_reflectance, si, active)
        tint_t = tint(self.specular_transmittance, si, active)
        if ctx.mode == TransportMode.Radiance:
            tint_t = tint_t * dr.square(eta_ti)
        return (bs_r, tint_r), (bs_t, tint_t), reflectance

    def transmittance(self, distance: Float) -> Color3f:
        if self.absorption is None:
            return Color3f(1)
        return dr.exp(-distance * self.absorption.eval(None))


def optional_texture(props: Properties, key: str) -> Texture | None:
    """The texture in [0, 1] under `key`, if there is one: traverse doesn't show what isn't given."""
    return props.texture(key, low=0.0, high=1.0) if key in props else None


def tint(texture: Texture | None, si: SurfaceInteraction3f, active: Bool | bool) -> Color3f:
    """The colour of an optional texture; white if it wasn't given."""
    return Color3f(1) if texture is None else texture.eval(si, active)


register_bsdf("dielectric", Dielectric)
