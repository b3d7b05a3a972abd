"""Pictures in models, decoded within limits."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from djpt.core.limits import MAX_NUMBERS, NUMBERS_PER_BYTE
from djpt.errors import SceneError

__all__ = ["decoded_image"]


def decoded_image(data: bytes, largest: int, where: str) -> tuple[NDArray[np.uint8], bool]:
    """The pixels of a PNG, JPEG or WebP file, RGBA, (H, W, 4), and whether they were made smaller.

    Args:
        data: the file's contents.
        largest: an image with more rows or columns is made smaller.
        where: for messages.

    Raises:
        SceneError: it is damaged, or has too many pixels for its size.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            picture: Any = Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "WEBP"))
            if picture.width * picture.height * 4 > max(MAX_NUMBERS, NUMBERS_PER_BYTE * len(data)):
                raise SceneError(f"{where} has {picture.width} x {picture.height} pixels, too many for its size")
            scale = largest / max(picture.size)
            if scale < 1:
                size = tuple(max(1, round(extent * scale)) for extent in picture.size)
                picture.draft("RGB", size)  # JPEG only: decoded at a fraction of the size
            if picture.mode.startswith("I;16"):
                picture = Image.fromarray((np.asarray(picture, np.uint16) >> 8).astype(np.uint8))
            picture = picture.convert("RGBA")
            if scale < 1:
                picture = picture.resize(size, Image.Resampling.BOX)
            return np.array(picture), scale < 1
    except SceneError:
        raise
    except MemoryError:
        raise SceneError(f"{where} doesn't fit into memory") from None
    except Exception as error:  # decoders fail in many ways
        raise SceneError(f"{where} can't be read: {error}") from None
