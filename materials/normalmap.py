"""Normals from an image."""

from __future__ import annotations

import drjit as dr

from djpt.core.records import SurfaceInteraction3f
from djpt.description.properties import Properties
from djpt.description.registry import register_bsdf
from djpt.jit.types import Bool, Vector3f
from djpt.materials.perturbed import PerturbedBSDF

__all__ = ["NormalMap"]


class NormalMap(PerturbedBSDF):
    """The nested BSDF about the normals of a texture, n = 2 colour - 1 in the shading frame.

    Parameters: `normalmap` (texture, required; a bitmap should have `raw` set), and those of `PerturbedBSDF`.
    x and y of a normal point along dp/du and towards dp/dv; (0.5, 0.5, 1) leaves it as it is.
    J. Cohen, M. Olano and D. Manocha, "Appearance-Preserving Simplification", SIGGRAPH 1998.
    """

    in_any_frame = True
    children = ("nested_bsdf", "normalmap")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.normalmap = props.texture("normalmap")

    def normal(self, si: SurfaceInteraction3f, active: Bool | bool) -> Vector3f:
        return Vector3f(dr.fma(self.normalmap.eval(si, active), 2, -1))


register_bsdf("normalmap", NormalMap)
