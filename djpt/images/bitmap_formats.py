"""What bitmaps are made of: formats of pixels and files, channels and layers, and metadata."""

from __future__ import annotations

import enum
from collections import UserDict
from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.color import RGB_TO_XYZ
from djpt.core.numeric import describe
from djpt.core.transforms import ScalarTransform4f, matrix_of
from djpt.errors import SceneError
from djpt.images.colorimetry import XYZ_TO_RGB
from djpt.images.structs import Field, Flags, Struct, Type

__all__ = [
    "CHANNELS",
    "AlphaTransform",
    "BitmapKinds",
    "FileFormat",
    "Metadata",
    "PixelFormat",
    "channel_names_of",
    "described",
    "file_format",
    "layers_of",
    "obtainable",
    "pixel_format_of",
]


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


def channel_names_of(form: PixelFormat, count: int, names: Sequence[str]) -> tuple[str, ...]:
    """The names of a bitmap's channels; ch0, ch1, ... if a `MultiChannel` one has none.

    Raises:
        SceneError: the number doesn't fit the format, or names are missing or not unique.
    """
    if form is not PixelFormat.MultiChannel:
        usual = CHANNELS[form]
        if count not in (0, len(usual)):
            raise SceneError(f"the pixel format {form.name} has {len(usual)} channels, found {count}")
        return usual
    if not names:
        digits = len(str(max(1, count - 1)))
        return tuple(f"ch{i:0{digits}d}" for i in range(count))
    if len(names) != count or len(set(names)) != count:
        raise SceneError(f"{count} different channel names needed, found {list(names)}")
    return tuple(names)


# ---- records of pixels -----------------------------------------------------------------------

OF_RGB = {name: dict(zip("RGB", row, strict=True)) for name, row in zip("XYZ", RGB_TO_XYZ, strict=True)}
"""X, Y and Z as sums of linear sRGB."""

OF_XYZ = {name: dict(zip("XYZ", row, strict=True)) for name, row in zip("RGB", XYZ_TO_RGB.tolist(), strict=True)}
"""Linear sRGB as sums of X, Y and Z."""

OF_Y = {"X": {"Y": 0.950456}, "Z": {"Y": 1.08875}}
"""X and Z of a grey, which has the white of D65; its R, G and B are Y."""


def described(names: Sequence[str], kind: Type, form: PixelFormat, srgb: bool, premultiplied: bool) -> Struct:
    """The record of a pixel. The channels A and W are alpha and weight; `MultiChannel` has no alpha."""
    struct = Struct()
    for name in names:
        flags = Flags.Normalized if kind.dtype.kind in "iu" else Flags.Empty
        if name == "A" and form is not PixelFormat.MultiChannel:
            flags |= Flags.Alpha
        elif name == "W":
            flags |= Flags.Weight
        else:
            flags |= (Flags.Gamma if srgb else Flags.Empty) | (
                Flags.PremultipliedAlpha if premultiplied else Flags.Empty
            )
        struct.append(name, kind, flags)
    return struct


def obtainable(source: Struct, target: Struct, form: PixelFormat) -> Struct:
    """The record `target` with sums for colours that `source`, of a pixel format, doesn't have; alpha and weight are 1.

    The sums of a film, red, green, blue and weight, are RGB, whatever the format says.

    Raises:
        SceneError: a channel can't be had.
    """
    first = "R" if [field.name for field in source] == list("RGBW") else CHANNELS.get(form, ("",))[0]
    sums = {"R": OF_RGB, "X": OF_XYZ, "Y": OF_Y}.get(first, {})
    result = Struct(target)
    for field in result:
        layer, dot, last = field.name.rpartition(".")
        if field.name in source or field.blend:
            continue
        if form in (PixelFormat.Y, PixelFormat.YA) and last in ("R", "G", "B"):
            field.source = f"{layer}{dot}Y"
        elif last in ("A", "W"):
            field.value = 1.0
            field.flags |= Flags.Default
        elif last in sums:
            field.blend = [(factor, f"{layer}{dot}{name}") for name, factor in sums[last].items()]
        else:
            have = ", ".join(entry.name for entry in source)
            raise SceneError(f"can't convert the bitmap: channel '{field.name}' can't be computed from {have}")
    return result


def layers_of(struct: Struct) -> dict[str, tuple[PixelFormat, dict[str, str]]]:
    """The layers of a record, sorted: format, and names of channels within the layer with their names in the record.

    Raises:
        SceneError: a layer other than the root has a weight.
    """
    found: dict[str, dict[str, Field]] = {}
    for field in struct:
        layer, _, last = field.name.rpartition(".")
        found.setdefault(layer or "<root>", {})[last] = field
    result = {}
    for layer in sorted(found):
        fields = found[layer]
        if "W" in fields and layer != "<root>":
            raise SceneError(f"layer '{layer}' has a weight, which only the root has")
        form = next((kind for kind, usual in CHANNELS.items() if set(usual) == set(fields)), PixelFormat.MultiChannel)
        order = CHANNELS.get(form, tuple(fields))
        result[layer] = form, {name: fields[name].name for name in order}
    return result


# ---- metadata --------------------------------------------------------------------------------


class Metadata(UserDict[str, Any]):
    """Names with texts, numbers, truth values, vectors of three numbers, or transforms.

    Lists of three numbers become vectors (`drjit.scalar.Array3f64`), 4 x 4 and 3 x 3 matrices `ScalarTransform4f`,
    as they come back from an exr file.

    Raises:
        SceneError: another kind of value is assigned.
    """

    def __setitem__(self, name: str, value: Any) -> None:
        self.data[name] = normal(name, value)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Metadata):
            return NotImplemented
        return self.numbers().keys() == other.numbers().keys() and all(
            np.array_equal(value, other.numbers()[name]) for name, value in self.numbers().items()
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Metadata({self.data!r})"

    def has_property(self, name: str) -> bool:
        """Whether there is a value of the name."""
        return name in self.data

    def numbers(self) -> dict[str, Any]:
        """The values, vectors and transforms as NumPy arrays."""
        return {name: value if is_plain(value) else np.asarray(matrix_of(value)) for name, value in self.data.items()}


def is_plain(value: Any) -> bool:
    """Whether a value is a text, a number or a truth value."""
    return isinstance(value, (str, bool, int, float))


def normal(name: str, value: Any) -> Any:
    """The form in which a value is kept."""
    if isinstance(value, (np.integer, np.floating)):
        value = value.item()
    if is_plain(value) or isinstance(value, ScalarTransform4f):
        return value
    try:
        array = np.array(matrix_of(value), np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape == (3,):
        return dr.scalar.Array3f64(*array.tolist())
    if array.shape in ((3, 3), (4, 4)):
        matrix = np.eye(4)
        matrix[: len(array), : len(array)] = array
        return ScalarTransform4f(matrix) if np.array_equal(matrix[3], (0, 0, 0, 1)) else dr.scalar.Matrix4f64(matrix)
    raise SceneError(
        f"metadata '{name}': must be a text, a number, three numbers or a 4x4 matrix, found {describe(value)}"
    )
