"""Scattering models: one BSDF per file, one registration line each."""

from __future__ import annotations

if __name__ != "djpt.materials":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.materials instead")

from djpt.description.registry import register_bsdf
from djpt.materials.base import BSDF
from djpt.materials.blendbsdf import BlendBSDF
from djpt.materials.blinn import Blinn
from djpt.materials.bumpmap import BumpMap
from djpt.materials.conductor import Conductor
from djpt.materials.dielectric import Dielectric
from djpt.materials.diffuse import Diffuse
from djpt.materials.glass import Glass
from djpt.materials.mask import Mask
from djpt.materials.mirror import Mirror
from djpt.materials.normalmap import NormalMap
from djpt.materials.null import Null
from djpt.materials.phong import Phong
from djpt.materials.plastic import Plastic
from djpt.materials.principled import Principled
from djpt.materials.principledthin import PrincipledThin
from djpt.materials.roughconductor import RoughConductor
from djpt.materials.roughdielectric import RoughDielectric
from djpt.materials.roughplastic import RoughPlastic
from djpt.materials.thindielectric import ThinDielectric
from djpt.materials.twosided import TwoSided

__all__ = [
    "BSDF",
    "BlendBSDF",
    "Blinn",
    "BumpMap",
    "Conductor",
    "Dielectric",
    "Diffuse",
    "Glass",
    "Mask",
    "Mirror",
    "NormalMap",
    "Null",
    "Phong",
    "Plastic",
    "Principled",
    "PrincipledThin",
    "RoughConductor",
    "RoughDielectric",
    "RoughPlastic",
    "ThinDielectric",
    "TwoSided",
]

register_bsdf("blendbsdf", BlendBSDF)
register_bsdf("blinn", Blinn)
register_bsdf("bumpmap", BumpMap)
register_bsdf("conductor", Conductor)
register_bsdf("dielectric", Dielectric)
register_bsdf("diffuse", Diffuse)
register_bsdf("glass", Glass)
register_bsdf("mask", Mask)
register_bsdf("mirror", Mirror)
register_bsdf("normalmap", NormalMap)
register_bsdf("null", Null)
register_bsdf("phong", Phong)
register_bsdf("plastic", Plastic)
register_bsdf("principled", Principled)
register_bsdf("principledthin", PrincipledThin)
register_bsdf("roughconductor", RoughConductor)
register_bsdf("roughdielectric", RoughDielectric)
register_bsdf("roughplastic", RoughPlastic)
register_bsdf("thindielectric", ThinDielectric)
register_bsdf("twosided", TwoSided)
