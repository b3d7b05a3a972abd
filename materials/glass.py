"""Smooth glass whose lobes can be shown one at a time."""

from __future__ import annotations

from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.errors import SceneError
from djpt.jit.types import Float
from djpt.materials.dielectric import REFLECTION, TRANSMISSION, Dielectric
from djpt.materials.fresnel import fresnel, fresnel_schlick

__all__ = ["Glass"]


class Glass(Dielectric):
    """A `dielectric` whose two lobes can be shown one at a time, and whose reflectance can be Schlick's.

    Parameters: those of `dielectric`, and

    * `fresnel`: `exact` (default) or `schlick`, see `djpt.materials.fresnel.fresnel_schlick`.
    * `reflection`, `transmission`: whether the lobe is there (default true; not both false). A lobe that is left alone
      is always sampled, and its weight is what it has of the whole: F or 1 - F (times eta_ti^2). So the images
      of both parts of one interface add up to that of glass. Refraction alone at equal indices shows the scene
      behind unchanged; where light would be totally reflected, it is black.
    """

    in_any_frame = True
    symmetric = True
    statics = ("absorbs", "fresnel", "reflection", "transmission")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.fresnel = props.string("fresnel", "exact", choices=("exact", "schlick"))
        self.reflection = props.boolean("reflection", True)
        self.transmission = props.boolean("transmission", True)
        if not (self.reflection or self.transmission):
            raise SceneError(
                f"{props.node}: 'reflection' and 'transmission' are both false: the surface would be black"
            )

    def components(self) -> tuple[int, ...]:
        return (REFLECTION,) * self.reflection + (TRANSMISSION,) * self.transmission

    def interface(self, cos_theta_i: Float) -> tuple[Float, Float, Float, Float]:
        return (fresnel_schlick if self.fresnel == "schlick" else fresnel)(cos_theta_i, self.eta)


register_bsdf("glass", Glass)
