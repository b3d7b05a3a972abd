"""Textures of models as nodes of `bitmap`, whatever format they come from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.images.srgb import decoded, encoded
from djpt.models.model import Matrix, Model

__all__ = ["Bitmaps", "Lookup", "encoded_bytes", "linear", "stored"]

PERIODS = 3
"""How often a texture is repeated along one axis if it is clamped along the other."""
MOST_WIDENED = 2**26
"""The most numbers of a texture that is repeated in memory."""
LINEAR = decoded(np.arange(256, dtype=np.float64) / 255)
"""Linear values of the bytes of sRGB."""


@dataclass(frozen=True)
class Lookup:
    """Where a texture is looked up."""

    uv_set: str
    """The texture coordinates, a key of `Part.coordinates`."""
    wrap: tuple[str, str] = ("repeat", "repeat")
    """Outside of [0, 1], along u and v: ``repeat``, ``mirror`` or ``clamp``."""
    matrix: Matrix | None = None
    """From the mesh's texture coordinates to those of the image, (4, 4); None where they are the same."""
    nearest: bool = False
    """Whether texels are squares."""


class Bitmaps:
    """Nodes of `bitmap`. Those that are alike share their pixels, as equal nodes of a scene then do.

    Args:
        model: warns of what can't be rendered.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._pixels: dict[Any, NDArray[Any]] = {}

    def node(self, key: Any, pixels: NDArray[Any], lookup: Lookup, *, raw: bool) -> dict[str, Any]:
        """The node of a texture.

        Args:
            key: what the pixels depend on.
            pixels: bytes or linear numbers, (H, W, C), the first row at v = 0.
            lookup: where it is looked up.
            raw: whether bytes are numbers, not colours of sRGB.
        """
        u, v = lookup.wrap
        matrix = np.eye(4) if lookup.matrix is None else lookup.matrix
        if u != v:
            if PERIODS * pixels.size > MOST_WIDENED:
                self.model.say(f"large textures wrap alike along u and v: '{u}'")
            else:
                pixels, u, widening = widened(pixels, u, v)
                matrix = widening @ matrix
                key = (key, lookup.wrap)
        node: dict[str, Any] = {"type": "bitmap", "wrap_mode": u, "uv_set": lookup.uv_set}
        node["bitmap" if pixels.dtype == np.uint8 else "data"] = self._pixels.setdefault(key, pixels)
        node["raw"] = raw or pixels.dtype != np.uint8
        if lookup.nearest:
            node["filter_type"] = "nearest"
        if (matrix != np.eye(4)).any():
            node["to_uv"] = ScalarTransform4f(matrix)
        return node

    def channel(self, key: Any, pixels: NDArray[np.uint8], channel: int, factor: float, lookup: Lookup) -> Any:
        """A texture of numbers in [0, 1]: one channel of an image, times a factor; a number where it is the same."""
        values = pixels[..., channel : channel + 1]
        if values.min() == values.max():
            return float(np.clip(factor * (values.flat[0] / 255), 0, 1))
        if factor != 1:
            values = np.clip(np.rint(values * factor), 0, 255).astype(np.uint8)
        return self.node((key, channel, factor), np.ascontiguousarray(values), lookup, raw=True)

    def cutout(
        self, key: Any, pixels: NDArray[np.uint8], channel: int, factor: float, cutoff: float, lookup: Lookup
    ) -> Any:
        """A texture of 1 where a channel times a factor reaches `cutoff`, else of 0; a number where it is the same."""
        values = np.where(pixels[..., channel : channel + 1] * (factor / 255) >= cutoff, 255, 0).astype(np.uint8)
        return self.channel((key, "cutout", cutoff, channel, factor), values, 0, 1.0, lookup)

    def color(
        self, key: Any, pixels: NDArray[np.uint8], factor: Matrix, lookup: Lookup, *, raw: bool = False
    ) -> dict[str, Any]:
        """A texture of colours, of sRGB or `raw`, times linear factors, (3,); clipped to [0, 1]."""
        if (factor == 1).all():
            return self.node(key, np.ascontiguousarray(pixels[..., :3]), lookup, raw=raw)
        # A table of 256 colours for each channel: most exact, and fast.
        colors = values_of_bytes(raw)[:, None] * factor
        table = np.rint(np.clip(colors, 0, 1) * 255).astype(np.uint8) if raw else encoded_bytes(colors)
        values = np.stack([table[pixels[..., i], i] for i in range(3)], axis=-1)
        return self.node((key, tuple(factor), raw), values, lookup, raw=raw)

    def light(
        self, key: Any, pixels: NDArray[np.uint8], factor: Matrix, lookup: Lookup, *, raw: bool = False
    ) -> dict[str, Any]:
        """A texture of radiances: colours of sRGB, or `raw`, times linear factors, (3,), of any size."""
        key = ("light", key, tuple(factor), raw)
        if key not in self._pixels:
            table = (values_of_bytes(raw)[:, None] * factor).astype(np.float32)
            self._pixels[key] = np.stack([table[pixels[..., i], i] for i in range(3)], axis=-1)
        return self.node(key, self._pixels[key], lookup, raw=True)


def values_of_bytes(raw: bool) -> Matrix:
    """The linear values of bytes, (256,), of sRGB or as numbers."""
    return np.arange(256) / 255 if raw else LINEAR


def encoded_bytes(values: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """The bytes of sRGB of linear values, clipped to [0, 1]."""
    return np.rint(encoded(np.clip(values, 0, 1)) * 255).astype(np.uint8)


def linear(bitmap: dict[str, Any]) -> NDArray[np.float32]:
    """The linear numbers of a bitmap, (H, W, C)."""
    pixels: NDArray[Any] = bitmap["bitmap"] if "bitmap" in bitmap else bitmap["data"]
    if pixels.dtype != np.uint8:
        return pixels.astype(np.float32)
    return values_of_bytes(bitmap["raw"]).astype(np.float32)[pixels]


def stored(values: NDArray[Any], bitmap: dict[str, Any]) -> dict[str, Any]:
    """The entries for linear numbers, stored as those of another bitmap are."""
    if "bitmap" not in bitmap:
        return {"data": values.astype(np.float32), "raw": True}
    if bitmap["raw"]:
        return {"bitmap": np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8), "raw": True}
    return {"bitmap": encoded_bytes(values), "raw": False}


def widened(pixels: NDArray[Any], u: str, v: str) -> tuple[NDArray[Any], str, Matrix]:
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
