"""Mitsuba's `mitsuba.util` verbs, under Mitsuba's names, so that a script ports by its import.

Nothing else lives here: each name is a thin wrapper over the module that owns the concept, or that module's own.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import Any, Final

from djpt.core.files import as_path
from djpt.description.parameters import SceneParameters, traverse
from djpt.images.bitmap import Bitmap
from djpt.images.formats import DISPLAY_FORMATS
from djpt.images.structs import Type
from djpt.jit.backends import set_variant, variant
from djpt.rendering.render import render
from djpt.scenes.cornell import cornell_box

__all__ = [
    "SceneParameters",
    "convert_to_bitmap",
    "cornell_box",
    "is_monochromatic",
    "is_polarized",
    "is_rgb",
    "is_spectral",
    "render",
    "scoped_set_variant",
    "traverse",
    "variant_context",
    "write_bitmap",
]

SINGLE = (".exr", ".hdr", ".pfm")
"""The formats of linear numbers that have no double precision."""


def write_bitmap(filename: str | os.PathLike[str], data: Any, write_async: bool = True, quality: int = -1) -> None:
    """Write an image: 8-bit sRGB to formats for displays (png, jpg, ...), to others what is there, at most float32.

    Args:
        filename: Of the file.
        data: As for `convert_to_bitmap`.
        write_async: Creates the file's folder if need be; else a folder that doesn't exist is an error. The file is
            complete on return in both cases. Mitsuba, whose thread can't report the error, writes nothing.
        quality: See `Bitmap.write`.

    Raises:
        SceneError: `data` isn't an image, or has channels that aren't colours and the format is one for displays.
        FileError: the file can't be written.
    """
    path = as_path(filename)
    suffix = path.suffix.lower()
    bitmap = convert_to_bitmap(data, uint8_srgb=suffix in DISPLAY_FORMATS)
    if suffix in SINGLE and bitmap.component_format() is Type.Float64:
        bitmap = bitmap.convert(component_format=Type.Float32)
    if write_async:
        with contextlib.suppress(OSError):  # said by `write` in words that name the file
            path.parent.mkdir(parents=True, exist_ok=True)
    bitmap.write(filename, quality=quality)


def convert_to_bitmap(data: Any, uint8_srgb: bool = True) -> Bitmap:
    """A bitmap of an image, as bytes of sRGB in three channels (default) or as it is.

    `data`: a `Bitmap`, a `TensorXf`, or an array of any library that NumPy reads, of linear values; a tensor of
    PyTorch's may be attached to gradients and on any device.
    """
    if hasattr(data, "detach") and hasattr(data, "cpu"):
        data = data.detach().cpu().numpy()
    bitmap = data if isinstance(data, Bitmap) else Bitmap(data)
    return bitmap.convert(Bitmap.PixelFormat.RGB, Type.UInt8, True) if uint8_srgb else bitmap


# ---- the variant -----------------------------------------------------------------------------


is_rgb: Final = True
is_monochromatic: Final = False
is_spectral: Final = False
is_polarized: Final = False


@contextlib.contextmanager
def variant_context(*names: str) -> Iterator[None]:
    """``set_variant(*names)`` for the block of a ``with``; then the variant that was set before.

    Raises:
        BackendError: see `djpt.set_variant`.
    """
    before = variant()
    set_variant(*names)
    try:
        yield
    finally:
        set_variant(before)


scoped_set_variant = variant_context
"""Another name of `variant_context`."""
