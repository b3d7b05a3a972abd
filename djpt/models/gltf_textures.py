"""Textures of glTF: images with samplers and transforms, as nodes of `bitmap`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.models.gltf_file import GltfFile, numbers, scalar
from djpt.models.model import Model

__all__ = ["Pixels", "Textures", "decoded", "encoded"]

WRAP = {33071: "clamp", 33648: "mirror", 10497: "repeat"}
NEAREST = 9728
PERIODS = 3
"""How often a texture is repeated along one axis if it is clamped along the other."""
MOST_WIDENED = 2**26
"""The most numbers of a texture that is repeated in memory."""

Pixels = NDArray[np.floating[Any]]


class Textures:
    """The textures of a file.

    Args:
        file: the file.
        model: what is made of it, which warns of what can't be rendered.
        largest: textures with more rows or columns are made smaller.
    """

    def __init__(self, file: GltfFile, model: Model, largest: int) -> None:
        self.file, self.model, self.largest = file, model, largest
        self._made: dict[Any, Any] = {}
        """Pixels by all that they depend on: textures that are alike share them."""

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

    def node(self, info: Any, pixels: NDArray[Any], key: Any, raw: bool) -> dict[str, Any]:
        """The node of a texture of these pixels, bytes or linear numbers, at the place that `info` says.

        Args:
            info: the reference to the texture.
            pixels: (H, W, C), the first row at v = 0.
            key: what the pixels depend on; equal keys share them, as equal nodes of a scene then do.
            raw: whether bytes are numbers, not colours of sRGB.
        """
        texture = self.file.at("textures", info["index"])
        sampler = self.file.at("samplers", texture["sampler"]) if "sampler" in texture else {}
        u, v = (WRAP.get(sampler.get(name, 10497), "repeat") for name in ("wrapS", "wrapT"))
        matrix = self._transform(info)
        wrap = u
        if u != v:
            if PERIODS * pixels.size > MOST_WIDENED:
                self.model.say(f"large textures wrap alike along u and v: '{u}'")
            else:
                pixels, wrap, widening = widened(pixels, u, v)
                matrix = widening @ matrix
                key = (key, u, v)
        node: dict[str, Any] = {"type": "bitmap", "wrap_mode": wrap}
        node |= {"bitmap" if pixels.dtype == np.uint8 else "data": self._made.setdefault(key, pixels)}
        node["raw"] = raw or pixels.dtype != np.uint8
        if sampler.get("magFilter") == NEAREST:
            node["filter_type"] = "nearest"
        if (matrix != np.eye(4)).any():
            node["to_uv"] = ScalarTransform4f(matrix)
        return node

    def _transform(self, info: Any) -> NDArray[np.float64]:
        """From texture coordinates of the mesh to those of the image, KHR_texture_transform."""
        matrix = np.eye(4)
        moved = self.file.extension(info, "KHR_texture_transform")
        if moved:
            offset, scale = numbers(moved.get("offset"), (0, 0)), numbers(moved.get("scale"), (1, 1))
            angle = scalar(moved.get("rotation"), 0.0)
            c, s = math.cos(angle), math.sin(angle)
            matrix[:2, :2] = np.array([[c, s], [-s, c]]) * np.where(scale == 0, 1e-6, scale)
            matrix[:2, 3] = offset
        return matrix

    def channel(self, info: Any, channel: int, factor: float, what: str) -> Any:
        """A scalar texture from one channel of a texture, times a factor; a number without a texture.

        Args:
            info: the reference to the texture.
            channel: 0 to 3.
            factor: in [0, 1].
            what: tells apart textures of the same channel.
        """
        pixels = self.pixels(info)
        if pixels is None:
            return float(np.clip(factor, 0, 1))
        values = pixels[..., channel : channel + 1]
        if values.min() == values.max():
            return float(np.clip(factor * (values.flat[0] / 255), 0, 1))
        if factor != 1:
            values = np.clip(np.rint(values * np.clip(factor, 0, 1)), 0, 255).astype(np.uint8)
        key = (what, info["index"], channel, factor)
        return self.node(info, np.ascontiguousarray(values), key, raw=True)

    def color(self, info: Any, factor: NDArray[np.float64]) -> Any:
        """A colour texture times a linear factor, in [0, 1]."""
        pixels = self.pixels(info)
        if pixels is None:
            return {"type": "rgb", "value": np.clip(factor, 0, 1).tolist()}
        key = ("color", info["index"], tuple(factor))
        if (factor == 1).all():
            return self.node(info, np.ascontiguousarray(pixels[..., :3]), key, raw=False)
        # A table of 256 colours for each channel: most exact, and fast.
        table = np.clip(encoded(decoded(np.arange(256)[:, None] / 255) * factor) * 255 + 0.5, 0, 255).astype(np.uint8)
        values = np.stack([table[pixels[..., i], i] for i in range(3)], axis=-1)
        return self.node(info, values, key, raw=False)


def widened(pixels: NDArray[Any], u: str, v: str) -> tuple[NDArray[Any], str, NDArray[np.float64]]:
    """Pixels that wrap alike along both axes as others do that wrap by `u` and `v`.

    A texture that is mirrored is one of twice the size that is repeated. Beside an axis that is clamped, a
    texture is repeated `PERIODS` times, around [0, 1], and clamped from there on.

    Returns:
        The pixels, how they wrap, and the matrix from the old texture coordinates to theirs, (4, 4).
    """
    matrix = np.eye(4)
    clamped = "clamp" in (u, v)
    for axis, mode in ((1, u), (0, v)):
        row = 1 - axis
        if mode == "mirror":
            pixels = np.concatenate([pixels, np.flip(pixels, axis)], axis)
            matrix[row] *= 0.5
        if clamped and mode != "clamp":
            pixels = np.concatenate([pixels] * PERIODS, axis)
            matrix[row] /= PERIODS
            matrix[row, 3] += (PERIODS // 2) / PERIODS
    return np.ascontiguousarray(pixels), "clamp" if clamped else "repeat", matrix


def decoded(values: Pixels) -> Pixels:
    """Linear values of sRGB's, in [0, 1]."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def encoded(values: Pixels) -> Pixels:
    """sRGB's values of linear ones, in [0, 1]."""
    values = np.clip(values, 0, 1)
    return np.where(values <= 0.0031308, values * 12.92, 1.055 * values ** (1 / 2.4) - 0.055)
