"""Textures, one per file. The file registers its texture; one line here imports it."""

from djpt.textures.base import Texture as Texture
from djpt.textures.bitmap import Bitmap as Bitmap
from djpt.textures.checkerboard import Checkerboard as Checkerboard
from djpt.textures.mesh_attribute import MeshAttribute as MeshAttribute
from djpt.textures.rgb import ConstantTexture as ConstantTexture
from djpt.textures.spectrum import SpectrumTexture as SpectrumTexture
from djpt.textures.uniform import UniformTexture as UniformTexture

__all__ = [name for name, value in globals().items() if isinstance(value, type)]
