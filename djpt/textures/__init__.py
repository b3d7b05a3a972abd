"""Textures: one file each, one registration line each."""

from djpt.description.registry import register_texture
from djpt.textures.base import Texture
from djpt.textures.rgb import ConstantTexture

__all__ = ["ConstantTexture", "Texture"]

register_texture("rgb", ConstantTexture)
