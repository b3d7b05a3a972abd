"""Textures: one file each, one registration line each."""

from djpt.description.registry import register_texture
from djpt.textures.base import Texture
from djpt.textures.bitmap import Bitmap
from djpt.textures.checkerboard import Checkerboard
from djpt.textures.mesh_attribute import MeshAttribute
from djpt.textures.rgb import ConstantTexture
from djpt.textures.spectrum import SpectrumTexture
from djpt.textures.uniform import UniformTexture

__all__ = ["Bitmap", "Checkerboard", "ConstantTexture", "MeshAttribute", "SpectrumTexture", "Texture", "UniformTexture"]

register_texture("bitmap", Bitmap)
register_texture("checkerboard", Checkerboard)
register_texture("mesh_attribute", MeshAttribute)
register_texture("rgb", ConstantTexture)
register_texture("spectrum", SpectrumTexture)
register_texture("uniform", UniformTexture)
