"""The records of bitmaps: which fields a pixel has, how others are had from them, and which layers they form."""

from __future__ import annotations

from collections.abc import Sequence

from djpt.core.color import RGB_TO_XYZ
from djpt.errors import SceneError
from djpt.images.bitmap_formats import CHANNELS, PixelFormat
from djpt.images.colorimetry import XYZ_TO_RGB
from djpt.images.structs import Field, Flags, Struct, Type

__all__ = ["described", "layers_of", "obtainable"]

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
