"""Textures of glTF: images with samplers and transforms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.models.gltf_file import GltfFile, numbers, scalar
from djpt.models.model import Matrix, Model
from djpt.models.textures import Bitmaps, Lookup

__all__ = ["Textures"]

WRAP = {33071: "clamp", 33648: "mirror", 10497: "repeat"}
NEAREST = 9728


class Textures:
    """The textures of a file.

    Args:
        file: the file.
        model: what is made of it, which warns of what can't be rendered.
        largest: textures with more rows or columns are made smaller.
    """

    def __init__(self, file: GltfFile, model: Model, largest: int) -> None:
        self.file, self.model, self.largest = file, model, largest
        self.bitmaps = Bitmaps(model)

    def pixels(self, info: Any) -> Any:
        """The pixels that a reference to a texture leads to, (H, W, 4); None if there are none."""
        if not isinstance(info, dict) or "index" not in info:
            return None
        texture = self.file.at("textures", info["index"])
        source = self.file.extension(texture, "EXT_texture_webp").get("source", texture.get("source"))
        if source is None:
            if self.file.extension(texture, "KHR_texture_basisu"):
                raise self.file.error("textures of the form 'KHR_texture_basisu' (KTX 2) can't be read")
            self.model.say("textures without an image are left out")
            return None
        pixels, smaller = self.file.image(source, self.largest)
        if smaller:
            self.model.say(f"textures are made smaller, to {self.largest} pixels: see 'texture_size'")
        return pixels

    def uv_set(self, info: Any) -> str:
        """The number of the texture coordinates that a reference to a texture names."""
        moved = self.file.extension(info, "KHR_texture_transform")
        found = moved.get("texCoord", info.get("texCoord", 0))
        return str(found) if isinstance(found, int) and 0 <= found < 100 else "0"

    def lookup(self, info: Any) -> Lookup:
        """Where a texture is looked up."""
        texture = self.file.at("textures", info["index"])
        sampler = self.file.at("samplers", texture["sampler"]) if "sampler" in texture else {}
        u, v = (WRAP.get(sampler.get(name, 10497), "repeat") for name in ("wrapS", "wrapT"))
        return Lookup(self.uv_set(info), (u, v), self._transform(info), sampler.get("magFilter") == NEAREST)

    def _transform(self, info: Any) -> Matrix | None:
        """From texture coordinates of the mesh to those of the image, KHR_texture_transform."""
        moved = self.file.extension(info, "KHR_texture_transform")
        if not moved:
            return None
        matrix = np.eye(4)
        offset, scale = numbers(moved.get("offset"), (0, 0)), numbers(moved.get("scale"), (1, 1))
        angle = scalar(moved.get("rotation"), 0.0)
        c, s = math.cos(angle), math.sin(angle)
        matrix[:2, :2] = np.array([[c, s], [-s, c]]) * np.where(scale == 0, 1e-6, scale)
        matrix[:2, 3] = offset
        return matrix

    def node(self, info: Any, pixels: NDArray[Any], key: Any, *, raw: bool) -> dict[str, Any]:
        """The node of a texture of these pixels at the place that `info` says; arguments as of `Bitmaps.node`."""
        return self.bitmaps.node((key, info["index"]), pixels, self.lookup(info), raw=raw)

    def channel(self, info: Any, channel: int, factor: float) -> Any:
        """A texture of one channel times a factor in [0, 1], or the number that it has everywhere."""
        pixels = self.pixels(info)
        factor = float(np.clip(factor, 0, 1))
        if pixels is None:
            return factor
        return self.bitmaps.channel(info["index"], pixels, channel, factor, self.lookup(info))

    def color(self, info: Any, factor: Matrix) -> dict[str, Any]:
        """A texture of colours times a linear factor, (3,), or the colour that it has everywhere."""
        pixels = self.pixels(info)
        factor = np.clip(factor, 0, 1)
        if pixels is None:
            return {"type": "rgb", "value": factor.tolist()}
        return self.bitmaps.color(info["index"], pixels, factor, self.lookup(info))
