"""Perfect mirrors."""

from __future__ import annotations

from djpt.core.records import SurfaceInteraction3f
from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.types import Bool, Color3f, Float
from djpt.materials.base import DeltaBSDF
from djpt.materials.conductor import Conductor
from djpt.materials.fresnel import fresnel_conductor, schlick
from djpt.materials.ior import metal

__all__ = ["Mirror"]

METAL = ("material", "eta", "k")


class Mirror(Conductor):
    """Mirror reflection of a fraction of light that depends on the angle or not; black from behind.

    Parameters: `reflectance` (texture in [0, 1], default 1), a factor; `material`, or `eta` and `k`, a metal as in
    `conductor` (default: none); `fresnel`, the fraction that is reflected:

    * `none` (default without a metal): R0 at all angles;
    * `schlick`: R0 + (1 - R0) (1 - cos theta)^5;
    * `exact` (default with a metal): `reflectance` times the metal's Fresnel reflectance.

    R0 is `reflectance` times the metal's reflectance at normal incidence, 1 without a metal.
    """

    in_any_frame = True
    symmetric = True
    children = ("eta", "k", "reflectance")
    statics = ("fresnel", "is_metal")

    def __init__(self, props: Properties) -> None:
        DeltaBSDF.__init__(self, props)
        self.reflectance = props.texture("reflectance", 1.0, low=0.0, high=1.0)
        self.is_metal = any(key in props for key in METAL)
        self.eta, self.k = metal(props)
        default = "exact" if self.is_metal else "none"
        self.fresnel = props.string("fresnel", default, choices=("none", "schlick", "exact"))

    def traverse(self, callback: TraversalCallback) -> None:
        for name in self.children if self.is_metal else ("reflectance",):
            callback.put(name, getattr(self, name))

    def reflectance_at(self, si: SurfaceInteraction3f, active: Bool | bool) -> Color3f:
        reflectance = self.reflectance.eval(si, active)
        if self.is_metal:
            cos_theta = si.wi.z if self.fresnel == "exact" else Float(1)
            reflectance = reflectance * fresnel_conductor(cos_theta, self.eta.eval(si, active), self.k.eval(si, active))
        return schlick(si.wi.z, reflectance) if self.fresnel == "schlick" else reflectance


register_bsdf("mirror", Mirror)
