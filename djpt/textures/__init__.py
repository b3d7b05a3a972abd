"""Textures, one per file. The file registers its texture; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.lazy import lazily

if TYPE_CHECKING:
    from djpt.textures.base import Texture as Texture
    from djpt.textures.bitmap import Bitmap as Bitmap
    from djpt.textures.checkerboard import Checkerboard as Checkerboard
    from djpt.textures.mesh_attribute import MeshAttribute as MeshAttribute
    from djpt.textures.rgb import ConstantTexture as ConstantTexture
    from djpt.textures.spectrum import SpectrumTexture as SpectrumTexture
    from djpt.textures.uniform import UniformTexture as UniformTexture
    from djpt.textures.volume import VolumeTexture as VolumeTexture
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
