"""The picture of a gradient check: forward mode | finite differences | what is between them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from djpt.errors import FileError
from djpt.images.formats import DISPLAY_FORMATS
from djpt.images.image import write
from djpt.images.sheets import DARK, Tile, captioned_sheet, enlarged
from djpt.validation.report import difference_picture

if TYPE_CHECKING:
    from djpt.validation.gradcheck.check import GradientCheck

__all__ = ["picture", "write_picture"]


def write_picture(result: GradientCheck, path: str | os.PathLike[str]) -> None:
    """Write `picture(result)` as png or jpg. Raises `FileError`."""
    if Path(path).suffix.lower() not in DISPLAY_FORMATS:
        raise FileError(f"can't write '{path}': the picture of a gradient check is a png or a jpg")
    write(path, picture(result))


def picture(result: GradientCheck) -> npt.NDArray[np.uint8]:
    """Three panels with captions, sRGB (H, W, 3): red where a larger value means more light, blue where less.

    All have one full scale, stated below them, which is exceeded by one pixel in a hundred.
    """
    ours, other = result.derivative, result.by_differences
    scale = max(float(np.quantile(np.abs(np.mean(ours, axis=2)), 0.99)), 1e-9)
    nothing = np.zeros_like(ours)
    panels = (
        (f"{result.key}: forward mode", f"full scale {scale:.2g}", ours, nothing),
        ("finite differences", f"{result.seeds} seeds of {result.spp} spp", other, nothing),
        ("the difference", "passed" if result.passed else "FAILED", ours, other),
    )
    tiles = [Tile(above, below, enlarged(difference_picture(a, b, scale))) for above, below, a, b in panels]
    return captioned_sheet(tiles, palette=DARK)
