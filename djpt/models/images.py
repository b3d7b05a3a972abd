"""Pictures in models, decoded within limits."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from djpt.core.limits import MAX_NUMBERS, NUMBERS_PER_BYTE
from djpt.errors import SceneError

__all__ = ["check_file", "decoded_image", "decoding"]


def decoded_image(data: bytes, largest: int, where: str) -> tuple[NDArray[np.uint8], bool]:
    """The pixels of a PNG, JPEG or WebP file, RGBA, (H, W, 4), and whether they were made smaller.

    Args:
        data: the file's contents.
        largest: an image with more rows or columns is made smaller.
        where: for messages.

    Raises:
        SceneError: it is damaged, or has too many pixels for its size.
    """
    with decoding(where):
        picture: Any = Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "WEBP"))
        check_size(picture, len(data), where)
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


def check_size(picture: Any, size: int, where: str) -> None:
    """Raise `SceneError` for a picture of more pixels than a file of `size` bytes may hold."""
    if picture.width * picture.height * 4 > max(MAX_NUMBERS, NUMBERS_PER_BYTE * size):
        raise SceneError(f"{where} has {picture.width} x {picture.height} pixels, too many for its size")


def check_file(data: bytes, where: str) -> None:
    """Raise `SceneError` if a file is a picture of too many pixels for its size; other files are fine."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            picture = Image.open(io.BytesIO(data))
        except Image.DecompressionBombError:
            raise SceneError(f"{where} has too many pixels") from None
        except (OSError, ValueError, SyntaxError):
            return
    check_size(picture, len(data), where)


@contextlib.contextmanager
def decoding(where: str) -> Iterator[None]:
    """Turn whatever goes wrong within a ``with`` block, where a picture is decoded, into a `SceneError`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except SceneError:
        raise
    except MemoryError:
        raise SceneError(f"{where} doesn't fit into memory") from None
    except UnidentifiedImageError:
        raise SceneError(f"{where} can't be read: it isn't a PNG, JPEG or WebP file, or damaged") from None
    except Exception as error:  # decoders fail in many ways
        raise SceneError(f"{where} can't be read: {error}") from None
