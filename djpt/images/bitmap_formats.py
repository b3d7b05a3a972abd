"""The kinds of bitmaps: what channels mean, how files store them, what happens to alpha."""

from __future__ import annotations

import enum

from djpt.images.structs import Type

__all__ = ["CHANNELS", "AlphaTransform", "BitmapKinds", "FileFormat", "PixelFormat", "file_format", "pixel_format_of"]


class PixelFormat(enum.Enum):
    """What the channels of a bitmap mean."""

    Y = 0
    YA = 1
    RGB = 2
    RGBA = 3
    RGBW = 3  # another name of RGBA, as in Mitsuba's Python
    RGBAW = 5
    XYZ = 6
    XYZA = 7
    MultiChannel = 8


class FileFormat(enum.Enum):
    """How files store bitmaps; `Auto`: by their content or their extension."""

    PNG = 0
    OpenEXR = 1
    RGBE = 2
    PFM = 3
    PPM = 4
    JPEG = 5
    TGA = 6
    BMP = 7
    Unknown = 8
    Auto = 9

    @property
    def suffix(self) -> str | None:
        """The extension of such files; None for `Auto` and `Unknown`."""
        return SUFFIXES.get(self)


class AlphaTransform(enum.Enum):
    """What a conversion does to colours: nothing, multiplication by alpha, or division."""

    Empty = 0
    Premultiply = 1
    Unpremultiply = 2


SUFFIXES = {
    FileFormat.PNG: ".png",
    FileFormat.OpenEXR: ".exr",
    FileFormat.RGBE: ".hdr",
    FileFormat.PFM: ".pfm",
    FileFormat.PPM: ".ppm",
    FileFormat.JPEG: ".jpg",
    FileFormat.TGA: ".tga",
    FileFormat.BMP: ".bmp",
}


class BitmapKinds:
    """The enumerations, and the types of numbers, as attributes of `Bitmap`."""

    PixelFormat = PixelFormat
    FileFormat = FileFormat
    AlphaTransform = AlphaTransform

    Invalid, UInt8, Int8, UInt16, Int16, UInt32, Int32, UInt64, Int64, Float16, Float32, Float64 = Type


CHANNELS: dict[PixelFormat, tuple[str, ...]] = {
    kind: tuple(kind.name) for kind in PixelFormat if kind is not PixelFormat.MultiChannel
}
"""The names of the channels of each format, which are its letters."""


def pixel_format_of(count: int) -> PixelFormat:
    """The format of an array with so many channels."""
    usual = {1: PixelFormat.Y, 2: PixelFormat.YA, 3: PixelFormat.RGB, 4: PixelFormat.RGBA}
    return usual.get(count, PixelFormat.MultiChannel)


def file_format(suffix: str | None) -> FileFormat:
    """The format of files with an extension, `Unknown` if there is none."""
    return next((kind for kind, own in SUFFIXES.items() if own == suffix), FileFormat.Unknown)
