"""Textures, one per file. The file registers its texture; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.textures.base import Texture as Texture
    from djpt.textures.bitmap import Bitmap as Bitmap
    from djpt.textures.blackbody import BlackBody as BlackBody
    from djpt.textures.checkerboard import Checkerboard as Checkerboard
    from djpt.textures.d65 import daylight as daylight
    from djpt.textures.irregular import IrregularSpectrum as IrregularSpectrum
    from djpt.textures.mesh_attribute import MeshAttribute as MeshAttribute
    from djpt.textures.rawconstant import RawConstant as RawConstant
    from djpt.textures.regular import RegularSpectrum as RegularSpectrum
    from djpt.textures.rgb import ConstantTexture as ConstantTexture
    from djpt.textures.spectrum import SpectrumTexture as SpectrumTexture
    from djpt.textures.srgb import SRGBReflectance as SRGBReflectance
    from djpt.textures.uniform import UniformTexture as UniformTexture
    from djpt.textures.volume import VolumeTexture as VolumeTexture
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
