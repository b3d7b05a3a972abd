"""The picture of a comparison: image | reference | difference."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from djpt.errors import FileError
from djpt.images.formats import DISPLAY_FORMATS
from djpt.images.image import write
from djpt.images.sheets import DARK, Tile, captioned_sheet, enlarged, shown

if TYPE_CHECKING:
    from djpt.validation.comparison import Comparison

__all__ = ["check_picture", "difference_picture", "picture", "write_picture"]

Bytes = npt.NDArray[np.uint8]


def check_picture(path: str | os.PathLike[str]) -> None:
    """Raise `FileError` unless the picture of a comparison can have this name; ask before rendering."""
    if Path(path).suffix.lower() not in DISPLAY_FORMATS:
        raise FileError(f"can't write '{path}': the picture of a comparison is a png or a jpg")


def write_picture(result: Comparison, path: str | os.PathLike[str]) -> None:
    """Write `picture(result)` as png or jpg. Raises `FileError`."""
    check_picture(path)
    write(path, picture(result))


def picture(result: Comparison) -> Bytes:
    """Three panels with captions, sRGB (H, W, 3).

    The third panel shows the mean over the channels of ours - Mitsuba's: red where ours is brighter, blue where it
    is darker. Its full scale, stated below it, is exceeded by one pixel in a hundred.
    """
    difference = np.abs(np.mean(result.image.astype(np.float64) - result.reference, axis=2))
    scale = max(float(np.quantile(difference, 0.99)), 1e-6)
    ours, theirs = shown(result.image), shown(result.reference)
    first, second = (
        f"{title}, {spp} spp" if spp else title
        for title, spp in zip(result.titles, (result.spp, result.reference_spp), strict=True)
    )
    tiles = [
        Tile(first, f"mean {np.mean(result.image):.5g}", ours),
        Tile(second, f"mean {np.mean(result.reference):.5g}", theirs),
        Tile(
            f"difference, RMSE {result.rmse:.3g}",
            f"red: {result.titles[0]} brighter; full scale {scale:.2g}",
            difference_picture(result.image, result.reference, scale),
        ),
    ]
    return captioned_sheet([replace(tile, picture=enlarged(tile.picture)) for tile in tiles], palette=DARK)


def difference_picture(image: Any, reference: Any, scale: float) -> Bytes:
    """Draw the signed difference, (H, W, 3): white for 0, red for +scale and more, blue for -scale and less."""
    signed = np.mean(np.asarray(image, np.float64) - np.asarray(reference, np.float64), axis=2) / scale
    away = np.clip(np.abs(signed), 0, 1)[..., None]
    hue = np.where(signed[..., None] > 0, np.array([178.0, 24, 43]), np.array([33.0, 102, 172]))
    return np.asarray(np.rint(255 + (hue - 255) * away), np.uint8)
