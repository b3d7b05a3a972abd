"""The encoding of sRGB (IEC 61966-2-1), and the pixels of pictures that are stored by it.

Stored pixels are whole numbers of 8 or 16 bits, so their linear values are looked up in tables.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Codes", "decoded", "encoded", "from_srgb", "shares", "strips", "to_srgb8"]

Codes = npt.NDArray[np.unsignedinteger[Any]]
"""Stored pixels, (H, W, C) of 8 or 16 bits; the type's largest number stands for 1."""
Pixels = npt.NDArray[np.float32]

CHUNK = 1 << 15
"""Numbers that are looked up at a time: what NumPy makes of them on its way stays in a core's own cache."""

STRIP = 1 << 20
"""The values that are encoded at a time, so that large images need little memory beside their own."""


# ---- the curve ---------------------------------------------------------------------------


def decoded(x: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Linear values of encoded ones, neither rounded nor clipped; those below 0 stay on the straight part."""
    wide = x.astype(np.float64)
    return np.where(wide <= 0.04045, wide / 12.92, ((np.maximum(wide, 0) + 0.055) / 1.055) ** 2.4)


def encoded(x: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """The inverse of `decoded`."""
    wide = x.astype(np.float64)
    return np.where(wide <= 0.0031308, 12.92 * wide, 1.055 * np.maximum(wide, 0) ** (1 / 2.4) - 0.055)


# ---- pixels ------------------------------------------------------------------------------


def strips(image: npt.NDArray[Any]) -> list[slice]:
    """The rows of an image (H, W, C), from top to bottom, in parts of about `STRIP` values."""
    rows = max(1, STRIP // max(1, image.shape[1] * image.shape[2]))
    return [slice(y, min(y + rows, len(image))) for y in range(0, len(image), rows)]


def to_srgb8(linear: Pixels) -> npt.NDArray[np.uint8]:
    """Convert linear values to 8-bit sRGB: clipped to [0, 1], encoded, rounded to nearest.

    Shape (H, W, C), any C. The last of 2 or 4 channels is alpha, which stays linear. NaN becomes 0.
    """
    result = np.empty(linear.shape, np.uint8)
    for strip in strips(linear):
        x = np.clip(np.nan_to_num(linear[strip], nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0).astype(np.float64)
        shown = encoded(x)
        if linear.shape[2] in (2, 4):
            shown[..., -1] = x[..., -1]
        result[strip] = np.floor(shown * 255.0 + 0.5)
    return result


def from_srgb(codes: Codes) -> Pixels:
    """Convert 8-bit or 16-bit sRGB to linear values, such that `to_srgb8(from_srgb(b)) == b` for bytes.

    Shape (H, W, C), any C. The last of 2 or 4 channels is alpha, which is linear.
    """
    linear = look_up(codes, decoding_table(codes.dtype.itemsize))
    if codes.shape[2] in (2, 4):
        linear[..., -1] = shares(codes[..., -1])
    return linear


def shares(codes: Codes) -> Pixels:
    """Stored numbers as they are, in [0, 1]: shares of the type's largest."""
    return look_up(codes, share_table(codes.dtype.itemsize))


# ---- tables --------------------------------------------------------------------------------


@functools.cache
def share_table(size: int) -> Pixels:
    """The fraction of each number of `size` bytes."""
    largest = 256**size - 1
    return (np.arange(largest + 1) / largest).astype(np.float32)


@functools.cache
def decoding_table(size: int) -> Pixels:
    """The linear value of each number of `size` bytes."""
    largest = 256**size - 1
    return decoded(np.arange(largest + 1) / largest).astype(np.float32)


def look_up(codes: Codes, table: Pixels) -> Pixels:
    """The entries of a table, in a new array of the shape of `codes`."""
    flat = np.ascontiguousarray(codes).reshape(-1)
    result = np.empty(flat.shape, np.float32)
    single = len(flat)
    if flat.itemsize == 1 and len(flat) >= 1 << 16:
        # Two bytes at a time.
        single = len(flat) % 2
        end = len(flat) - single
        take(in_pairs(table.tobytes()), flat[:end].view(np.uint16), result[:end].view(np.uint64))
    take(table, flat[len(flat) - single :], result[len(flat) - single :])
    return result.reshape(codes.shape)


def take(table: npt.NDArray[Any], index: npt.NDArray[Any], out: npt.NDArray[Any]) -> None:
    """Look numbers up in a table that has an entry for each."""
    for start in range(0, len(index), CHUNK):
        part = slice(start, start + CHUNK)
        np.take(table, index[part], out=out[part], mode="clip")  # 'raise' would copy


@functools.cache
def in_pairs(table: bytes) -> npt.NDArray[np.uint64]:
    """The two entries, as one word, for each two bytes in a row."""
    both = np.arange(1 << 16, dtype=np.uint16).view(np.uint8).reshape(-1, 2)
    return np.frombuffer(table, np.float32)[both].view(np.uint64).ravel()
