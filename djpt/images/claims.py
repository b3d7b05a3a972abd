"""What the header of an image says about its size, before memory of that size is taken: for files of strangers."""

from __future__ import annotations

from pathlib import Path

from djpt.core.files import shortened
from djpt.core.limits import MAX_NUMBERS, NUMBERS_PER_BYTE
from djpt.errors import FileError
from djpt.images.formats import picture_numbers
from djpt.images.image import reading

__all__ = ["require_modest"]

FULL_SIZE = frozenset({".hdr", ".pfm", ".npy"})
"""Formats whose readers compare the size in the header with that of the file: a byte stands for few numbers."""


def require_modest(path: Path) -> None:
    """Raise `FileError` if an image has many more numbers than its file has bytes.

    Up to `MAX_NUMBERS` are fine, and `NUMBERS_PER_BYTE` for each byte. Only the header is read.
    """
    suffix = path.suffix.lower()
    if suffix in FULL_SIZE:
        return
    with reading(path):
        count = exr_numbers(path) if suffix == ".exr" else picture_numbers(path)
        size = path.stat().st_size
    if count > max(MAX_NUMBERS, NUMBERS_PER_BYTE * size):
        raise FileError(
            f"can't read '{shortened(path)}': by its header its {size} bytes hold {count} numbers, more than an "
            "untrusted scene may ask for"
        )


def exr_numbers(path: Path) -> int:
    """The numbers of all parts of an OpenEXR file, by its headers."""
    import OpenEXR

    total = 0
    with OpenEXR.File(str(path), header_only=True) as file:
        for part in file.parts:
            (left, top), (right, bottom) = part.header["dataWindow"]
            total += (int(right) - int(left) + 1) * (int(bottom) - int(top) + 1) * len(part.header["channels"])
    return total
