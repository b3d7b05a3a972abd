"""The picture of a comparison: djpt | Mitsuba | difference."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from djpt.errors import FileError
from djpt.images.formats import DISPLAY_FORMATS
from djpt.images.image import Image, write

if TYPE_CHECKING:
    from djpt.validation.compare import Comparison

__all__ = ["difference_picture", "picture", "write_picture"]

Bytes = npt.NDArray[np.uint8]

_LEAST_WIDTH = 256
"""Smaller images are enlarged by a whole factor, so that the captions fit."""

_GAP, _CAPTION = 8, 40


def write_picture(result: Comparison, path: str | os.PathLike[str]) -> None:
    """Write `picture(result)` as png or jpg. Raises `FileError`."""
    if Path(path).suffix.lower() not in DISPLAY_FORMATS:
        raise FileError(f"can't write '{path}': the picture of a comparison is a png or a jpg")
    write(path, picture(result))


def picture(result: Comparison) -> Bytes:
    """Three panels with captions, sRGB (H, W, 3).

    The third panel shows the mean over the channels of ours - Mitsuba's: red where ours is brighter, blue where it
    is darker. Its full scale, stated below it, is exceeded by one pixel in a hundred.
    """
    difference = np.abs(np.mean(result.image.astype(np.float64) - result.reference, axis=2))
    scale = max(float(np.quantile(difference, 0.99)), 1e-6)
    panels = [_shown(result.image), _shown(result.reference), difference_picture(result.image, result.reference, scale)]
    captions = [
        (f"djpt, {result.spp} spp", f"mean {np.mean(result.image):.5g}"),
        (f"Mitsuba, {result.reference_spp} spp", f"mean {np.mean(result.reference):.5g}"),
        (f"difference, RMSE {result.rmse:.3g}", f"red: ours brighter; full scale {scale:.2g}"),
    ]
    factor = -(-_LEAST_WIDTH // panels[0].shape[1])
    panels = [panel.repeat(factor, axis=0).repeat(factor, axis=1) for panel in panels]
    height, width, _ = panels[0].shape
    sheet = np.full((height + _CAPTION + 2 * _GAP, 3 * width + 4 * _GAP, 3), 24, np.uint8)
    for i, panel in enumerate(panels):
        left = _GAP + i * (width + _GAP)
        sheet[_GAP : _GAP + height, left : left + width] = panel
    return _with_captions(sheet, captions, height + _GAP + 4, width + _GAP)


def difference_picture(image: Any, reference: Any, scale: float) -> Bytes:
    """Draw the signed difference, (H, W, 3): white for 0, red for +scale and more, blue for -scale and less."""
    signed = np.mean(np.asarray(image, np.float64) - np.asarray(reference, np.float64), axis=2) / scale
    away = np.clip(np.abs(signed), 0, 1)[..., None]
    hue = np.where(signed[..., None] > 0, np.array([178.0, 24, 43]), np.array([33.0, 102, 172]))
    return np.asarray(np.rint(255 + (hue - 255) * away), np.uint8)


def _shown(image: Any) -> Bytes:
    """Convert an image of any number of channels to RGB bytes."""
    pixels = Image(image).srgb()
    return pixels[..., :3] if pixels.shape[2] >= 3 else pixels[..., :1].repeat(3, axis=2)


def _with_captions(sheet: Bytes, captions: list[tuple[str, str]], top: int, step: int) -> Bytes:
    from PIL import Image as Picture
    from PIL import ImageDraw

    canvas = Picture.fromarray(sheet)
    draw = ImageDraw.Draw(canvas)
    for i, lines in enumerate(captions):
        for j, line in enumerate(lines):
            draw.text((_GAP + i * step + 2, top + 16 * j), line, fill=(230, 230, 230) if j == 0 else (160, 160, 160))
    return np.asarray(canvas)
