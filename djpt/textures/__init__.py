"""Textures: one file each, one registration line each."""

from djpt.description.registry import register_texture
from djpt.textures.base import Texture
from djpt.textures.rgb import ConstantTexture
from djpt.textures.spectrum import SpectrumTexture

__all__ = ["ConstantTexture", "SpectrumTexture", "Texture"]

register_texture("rgb", ConstantTexture)
register_texture("spectrum", SpectrumTexture)
