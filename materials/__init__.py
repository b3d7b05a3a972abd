"""Scattering models, one BSDF per file. The file registers its BSDF; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if __name__ != "djpt.materials":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.materials instead")

if TYPE_CHECKING:
    from djpt.materials.base import BSDF as BSDF
    from djpt.materials.blendbsdf import BlendBSDF as BlendBSDF
    from djpt.materials.blinn import Blinn as Blinn
    from djpt.materials.bumpmap import BumpMap as BumpMap
    from djpt.materials.circular import Circular as Circular
    from djpt.materials.conductor import Conductor as Conductor
    from djpt.materials.dielectric import Dielectric as Dielectric
    from djpt.materials.diffuse import Diffuse as Diffuse
    from djpt.materials.glass import Glass as Glass
    from djpt.materials.hair import Hair as Hair
    from djpt.materials.mask import Mask as Mask
    from djpt.materials.measured import Measured as Measured
    from djpt.materials.mirror import Mirror as Mirror
    from djpt.materials.normalmap import NormalMap as NormalMap
    from djpt.materials.null import Null as Null
    from djpt.materials.phong import Phong as Phong
    from djpt.materials.plastic import Plastic as Plastic
    from djpt.materials.polarizer import Polarizer as Polarizer
    from djpt.materials.pplastic import PolarizedPlastic as PolarizedPlastic
    from djpt.materials.principled import Principled as Principled
    from djpt.materials.principledthin import PrincipledThin as PrincipledThin
    from djpt.materials.retarder import Retarder as Retarder
    from djpt.materials.roughconductor import RoughConductor as RoughConductor
    from djpt.materials.roughdielectric import RoughDielectric as RoughDielectric
    from djpt.materials.roughplastic import RoughPlastic as RoughPlastic
    from djpt.materials.thindielectric import ThinDielectric as ThinDielectric
    from djpt.materials.twosided import TwoSided as TwoSided
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
