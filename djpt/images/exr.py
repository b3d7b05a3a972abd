"""OpenEXR: channels of one type with names, and attributes."""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from djpt.images.resampling import lanczos, resampled, taps_between

__all__ = ["FILLER", "OF_XYZ", "ORDER", "RESERVED", "read_attributes", "read_layers", "usual_names", "write_layers"]

Pixels = npt.NDArray[Any]

ORDER = "channelOrder"
"""The attribute in which `djpt.write` stores the order of channels; the format sorts them by name."""

FILLER = "filler"
"""The attribute by which a header keeps its size when the others change: see `djpt.images.row_files`."""

RESERVED = frozenset(
    f"{ORDER} {FILLER} channels chunkCount compression dataWindow displayWindow dwaCompressionLevel envmap lineOrder "
    "maxSamplesPerPixel multiView name pixelAspectRatio preview screenWindowCenter screenWindowWidth tiles type "
    "version view zipCompressionLevel".split()
)
"""Attributes with a meaning of their own, which metadata can't use."""

NAMES = {1: ("Y",), 2: ("Y", "A"), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}

CLASSES = ("r", "g", "b", "x", "y", "z", "a", "ry", "by")
"""The last parts of names by which the channels of a layer are sorted."""

BT709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""The chromaticities of red, green, blue and white that a file has unless it says otherwise."""
OF_XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)
"""The chromaticities that say that the channels R, G and B are X, Y and Z."""


class Layers(NamedTuple):
    """The content of a file."""

    names: tuple[str, ...]
    """The names of the channels: those without a layer first, colours as R G B, X Y Z, Y, A, others by name."""
    pixels: Pixels
    """(H, W, C), float16, float32 or uint32."""
    attributes: dict[str, Any]


def usual_names(count: int) -> tuple[str, ...]:
    """Names for channels that have none: Y; Y A; R G B; R G B A; otherwise C0, C1, ..."""
    digits = len(str(count - 1))
    return NAMES.get(count) or tuple(f"C{i:0{digits}d}" for i in range(count))


def write_layers(
    path: Path, pixels: Pixels, names: Sequence[str], attributes: Mapping[str, Any], quality: int = -1
) -> None:
    """Write channels (H, W, C) of float16, float32 or uint32.

    `quality`: above 0, the loss of the compression DWAB (45 is usual, more is smaller); otherwise none is lost.
    """
    import OpenEXR

    header = {**attributes, "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if quality > 0:
        header |= {"compression": OpenEXR.DWAB_COMPRESSION, "dwaCompressionLevel": float(quality)}
    if tuple(names[:3]) == ("X", "Y", "Z"):
        header["chromaticities"] = OF_XYZ
    planes = {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}
    OpenEXR.File(header, planes).write(str(path))
    require_whole(path)


def require_whole(path: Path) -> None:
    """Raise `OSError` unless a file can be read to its end: OpenEXR misses that a disk is full when it closes a file.

    The offsets of all lines of pixels are written last, behind the header: zeros mean that they weren't. Lines follow
    each other, each with its number and its size.
    """
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            place = 8
            while data[place]:
                for _ in range(2):  # the name of an attribute, and its type
                    zero = data.find(b"\0", place)
                    if zero < 0:
                        raise ValueError("the header ends too early")
                    place = zero + 1
                place += 4 + struct.unpack_from("<i", data, place)[0]
            (first,) = struct.unpack_from("<Q", data, place + 1)
            offsets = np.frombuffer(data[place + 1 : first], "<u8")
            last = int(offsets.max())
            end = last + 8 + struct.unpack_from("<i", data, last + 4)[0]
            whole = offsets.min() > 0 and end <= len(data)
    except (ValueError, IndexError, struct.error):
        whole = False
    if not whole:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def read_attributes(path: Path) -> dict[str, Any]:
    """All attributes of a file's header."""
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as file:
        # The header is emptied when the file is closed.
        return dict(file.header())


def read_layers(path: Path) -> Layers:
    """Read a file: subsampled channels are enlarged, luminance and chroma and other primaries become linear sRGB.

    Channels have the type of the first one by name. If the chromaticities say that R, G and B are X, Y and Z, they
    have these names.
    """
    import OpenEXR

    attributes = read_attributes(path)
    stored = {channel.name: (channel.xSampling, channel.ySampling) for channel in attributes["channels"]}
    names = sorted(stored, key=_place)
    together = "".join(names)
    if together in ("RGB", "RGBA") and set(stored.values()) == {(1, 1)}:
        # The library refuses to put channels of different types side by side.
        with contextlib.suppress(ValueError), OpenEXR.File(str(path)) as file:
            return _in_srgb(Layers(tuple(names), np.asarray(file.channels()[together].pixels), attributes))
    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = {name: channel.pixels for name, channel in file.channels().items()}
    (left, top), (right, bottom) = attributes["dataWindow"]
    pixels: Pixels = np.empty((bottom - top + 1, right - left + 1, len(names)), planes[min(planes)].dtype)
    for i, name in enumerate(names):
        plane = planes[name]
        for axis in range(2):
            if plane.shape[axis] != pixels.shape[axis]:
                taps = taps_between(plane.shape[axis], pixels.shape[axis], lanczos, 2.0)
                plane = resampled(plane.swapaxes(0, axis), taps).swapaxes(0, axis)
        pixels[..., i] = plane
    return _in_srgb(_without_chroma(Layers(tuple(names), pixels, attributes)))


def _place(name: str) -> str:
    """The key by which channels are sorted: the layer, then the kind of colour or the name."""
    layer, dot, last = name.rpartition(".")
    kind = last.lower()
    return f"{layer}{dot}{1 + CLASSES.index(kind)}" if kind in CLASSES else name


def _without_chroma(layers: Layers) -> Layers:
    """R, G and B in place of luminance Y and RY = R/Y - 1, BY = B/Y - 1."""
    names, pixels, attributes = layers
    kinds = [name.upper() for name in names]
    if sorted(set(kinds) - {"A"}) != ["BY", "RY", "Y"]:
        return layers
    y, ry, by = (pixels[..., kinds.index(kind)].astype(np.float32) for kind in ("Y", "RY", "BY"))
    shares = _to_xyz(attributes.get("chromaticities", BT709))[1]
    r, b = (ry + 1) * y, (by + 1) * y
    colors = [r, (y - r * shares[0] - b * shares[2]) / shares[1], b]
    alpha = [pixels[..., kinds.index("A")]] if "A" in kinds else []
    result = np.stack([plane.astype(pixels.dtype) for plane in (*colors, *alpha)], axis=2)
    return Layers(NAMES[3 + len(alpha)], result, attributes)


def _in_srgb(layers: Layers) -> Layers:
    """R, G and B in the primaries of sRGB, or named X, Y, Z if they are that."""
    names, pixels, attributes = layers
    primaries = attributes.get("chromaticities", BT709)
    if names not in (NAMES[3], NAMES[4]) or np.allclose(primaries, BT709, atol=4e-4):
        return layers
    if np.allclose(primaries, OF_XYZ, atol=4e-4):
        return Layers(("X", "Y", "Z", *names[3:]), pixels, attributes)
    matrix = np.linalg.inv(_to_xyz(BT709)) @ _to_xyz(primaries)
    result = pixels.copy()
    result[..., :3] = pixels[..., :3].astype(np.float32) @ matrix.T.astype(np.float32)
    return Layers(names, result, attributes)


def _to_xyz(primaries: Sequence[float]) -> npt.NDArray[np.float64]:
    """The matrix from R, G and B of some primaries to XYZ, such that white has Y = 1."""
    xy = np.reshape(np.asarray(primaries, np.float64), (4, 2))
    xyz = np.column_stack([xy, 1 - xy.sum(axis=1)])
    return xyz[:3].T * np.linalg.solve(xyz[:3].T, xyz[3] / xyz[3, 1])
