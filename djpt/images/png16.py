"""PNG files of 16 bits per channel (W3C, *Portable Network Graphics*, third edition), which Pillow reduces to 8.

Grey, RGB, and both with alpha; not interlaced.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

__all__ = ["COLOR_TYPES", "SIGNATURE", "SRGB", "chunk", "decode_png16", "encode_png16", "is_png16", "text_chunk"]

SIGNATURE = b"\x89PNG\r\n\x1a\n"
COLOR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}
"""The code of the colour type, by the number of channels."""

Codes = npt.NDArray[np.uint16]
Bytes = npt.NDArray[np.uint8]


def is_png16(path: Path) -> bool:
    """True if a file is a PNG that `decode_png16` reads."""
    with path.open("rb") as file:
        head = file.read(29)
    return (
        head[:8] == SIGNATURE
        and len(head) == 29
        and head[24] == 16
        and head[25] in COLOR_TYPES.values()
        and head[28] == 0
    )


# ---- reading -----------------------------------------------------------------------------


def decode_png16(path: Path) -> Codes:
    """The stored numbers, (H, W, C).

    Raises:
        ValueError: damaged.
    """
    data = path.read_bytes()
    width, height = struct.unpack(">II", data[16:24])
    channels = {color: count for count, color in COLOR_TYPES.items()}[data[25]]
    stride = 1 + 2 * channels * width
    packed = b"".join(body for kind, body in chunks(data) if kind == b"IDAT")
    # A forged header can't ask for more memory than deflate can fill, which shrinks by 1032 at most.
    if width == 0 or height == 0 or stride * height > 1100 * len(packed):
        raise ValueError(f"size {width} x {height} for {len(packed)} bytes")
    lines = zlib.decompressobj().decompress(packed, stride * height)
    if len(lines) != stride * height:
        raise ValueError("the file ends too early")
    rows = np.frombuffer(lines, np.uint8).reshape(height, stride)
    pixels = unfiltered(rows[:, 1:].reshape(height, width, 2 * channels), rows[:, 0])
    return pixels.view(">u2").astype(np.uint16)


def chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    """The kinds and contents of a file's chunks."""
    result, at = [], len(SIGNATURE)
    while at + 12 <= len(data):
        (size,) = struct.unpack(">I", data[at : at + 4])
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        if zlib.crc32(kind + body).to_bytes(4, "big") != data[at + 8 + size : at + 12 + size]:
            raise ValueError(f"chunk {kind.decode('latin-1')} is damaged")
        result.append((kind, body))
        at += 12 + size
    return result


def unfiltered(coded: Bytes, kinds: Bytes) -> Bytes:
    """Undo the prediction of bytes (H, W, bytes of a pixel) from their neighbours; `kinds`: one filter per row.

    A pixel is predicted from those on the left, above, and above on the left, so pixels of one skewed diagonal don't
    depend on each other and are computed together.
    """
    if kinds.max() > 4:
        raise ValueError(f"unknown filter {kinds.max()}")
    height, width, _ = coded.shape
    # A row and a column of zeros stand for what lies outside.
    result = np.zeros((height + 1, width + 1, coded.shape[2]), np.int16)
    for diagonal in range(width + height - 1):
        y = np.arange(max(0, diagonal - width + 1), min(height, diagonal + 1))
        x = diagonal - y
        left, above, corner = result[y + 1, x], result[y, x + 1], result[y, x]
        kind = kinds[y][:, None]
        guess = np.select(
            [kind == 1, kind == 2, kind == 3, kind == 4],
            [left, above, (left + above) // 2, paeth(left, above, corner)],
            0,
        )
        result[y + 1, x + 1] = (coded[y, x] + guess) & 255
    return np.ascontiguousarray(result[1:, 1:].astype(np.uint8))


def paeth(a: npt.NDArray[np.int16], b: npt.NDArray[np.int16], c: npt.NDArray[np.int16]) -> npt.NDArray[np.int16]:
    """A. Paeth's predictor: of left, above and corner, the one nearest to left + above - corner."""
    to_a, to_b, to_c = np.abs(b - c), np.abs(a - c), np.abs(a + b - 2 * c)
    return np.where((to_a <= to_b) & (to_a <= to_c), a, np.where(to_b <= to_c, b, c))


# ---- writing -----------------------------------------------------------------------------


def encode_png16(pixels: Codes, metadata: Mapping[str, str], level: int, srgb: bool) -> bytes:
    """The file of an image, each row predicted by the one above.

    Args:
        pixels: (H, W, C) of 1 to 4 channels.
        metadata: Text chunks: tEXt, or iTXt for what isn't Latin-1.
        level: Of compression, 1 to 9.
        srgb: Whether the file says that its colours are sRGB.
    """
    height, width, channels = pixels.shape
    lines = np.ascontiguousarray(pixels.astype(">u2")).view(np.uint8).reshape(height, -1)
    coded = np.full((height, lines.shape[1] + 1), 2, np.uint8)
    coded[:, 1:] = lines
    coded[1:, 1:] -= lines[:-1]
    head = struct.pack(">IIBBBBB", width, height, 16, COLOR_TYPES[channels], 0, 0, 0)
    parts = [chunk(b"IHDR", head)]
    if srgb:
        parts.append(SRGB)
    parts += [text_chunk(name, text) for name, text in metadata.items()]
    parts += [chunk(b"IDAT", zlib.compress(coded.tobytes(), level)), chunk(b"IEND", b"")]
    return SIGNATURE + b"".join(parts)


def text_chunk(name: str, text: str) -> bytes:
    """A named text."""
    try:
        return chunk(b"tEXt", name.encode("latin-1") + b"\0" + text.encode("latin-1"))
    except UnicodeEncodeError:
        return chunk(b"iTXt", name.encode("latin-1", "replace") + b"\0\0\0\0\0" + text.encode())


def chunk(kind: bytes, body: bytes) -> bytes:
    """A chunk with its length and checksum."""
    return struct.pack(">I", len(body)) + kind + body + zlib.crc32(kind + body).to_bytes(4, "big")


SRGB = chunk(b"gAMA", (45455).to_bytes(4, "big")) + chunk(b"sRGB", b"\0")
"""Says that colours are sRGB, for readers that know it (rendering intent: perceptual) and by its gamma for others."""
