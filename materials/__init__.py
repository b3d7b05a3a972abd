"""Scattering models: one BSDF per file, one registration line each."""

from __future__ import annotations

if __name__ != "djpt.materials":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.materials instead")

from djpt.description.registry import register_bsdf
from djpt.materials.base import BSDF
from djpt.materials.diffuse import Diffuse
from djpt.materials.principled import Principled
from djpt.materials.principledthin import PrincipledThin
from djpt.materials.twosided import TwoSided

__all__ = ["BSDF", "Diffuse", "Principled", "PrincipledThin", "TwoSided"]

register_bsdf("diffuse", Diffuse)
register_bsdf("principled", Principled)
register_bsdf("principledthin", PrincipledThin)
register_bsdf("twosided", TwoSided)
