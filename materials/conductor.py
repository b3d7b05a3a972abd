"""Smooth metal."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.types import Bool, Color3f, Float
from djpt.materials.base import DeltaBSDF
from djpt.materials.fresnel import fresnel_conductor, reflect
from djpt.materials.ior import metal

__all__ = ["Conductor"]


class Conductor(DeltaBSDF):
    """Mirror reflection with the Fresnel reflectance of a complex index eta + i k; black from behind.

    Parameters: `material` (a name of `djpt.materials.ior.METALS`, default `none`: everything is reflected) or
    `eta` and `k` (textures in [0, 1e6], defaults 0 and 1); `specular_reflectance` (texture in [0, 1], default 1), a
    factor that real metals don't have.
    """

    in_any_frame = True
    symmetric = True
    children = ("eta", "k", "specular_reflectance")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.eta, self.k = metal(props)
        self.specular_reflectance = props.texture("specular_reflectance", 1.0, low=0.0, high=1.0)

    def components(self) -> tuple[int, ...]:
        return (int(BSDFFlags.DeltaReflection | BSDFFlags.FrontSide),)

    def reflectance_at(self, si: SurfaceInteraction3f, active: Bool | bool) -> Color3f:
        """The fraction of light that is reflected towards `si.wi`."""
        fresnel = fresnel_conductor(si.wi.z, self.eta.eval(si, active), self.k.eval(si, active))
        return self.specular_reflectance.eval(si, active) * fresnel

    def bounce(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, sample1: Float, active: Bool | bool
    ) -> tuple[BSDFSample3f, Color3f]:
        weight = dr.select(si.wi.z > 0, self.reflectance_at(si, active), 0)
        return BSDFSample3f.of(reflect(si.wi), 1, BSDFFlags.DeltaReflection), weight


register_bsdf("conductor", Conductor)
