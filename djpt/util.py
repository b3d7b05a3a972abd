"""Mitsuba's `mitsuba.util` verbs, under Mitsuba's names, so that a script ports by its import.

Nothing else lives here: each name is a thin wrapper over the module that owns the concept, or that module's own.
"""

from __future__ import annotations

import os
from typing import Any

from djpt.images.image import Image, write
from djpt.parameters import SceneParameters, traverse
from djpt.rendering import render
from djpt.scenes.cornell import cornell_box
from djpt.scripting.variants import scoped_set_variant, variant_context

__all__ = [
    "SceneParameters",
    "convert_to_bitmap",
    "cornell_box",
    "render",
    "scoped_set_variant",
    "traverse",
    "variant_context",
    "write_bitmap",
]


def write_bitmap(filename: str | os.PathLike[str], data: Any, write_async: bool = True, quality: int = -1) -> None:
    """`djpt.write(filename, data)`.

    `write_async` and `quality` are accepted for compatibility: the file is complete on return, and
    jpg has quality 95. Differs from Mitsuba in that 8-bit files are not dithered.
    """
    write(filename, data)


def convert_to_bitmap(data: Any, uint8_srgb: bool = True) -> Image:
    """An `Image` of sRGB bytes (default) or of linear float32 values, for display and for NumPy."""
    image = Image(data)
    return Image(image.srgb()) if uint8_srgb else image
