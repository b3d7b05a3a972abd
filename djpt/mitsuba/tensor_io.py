"""Mitsuba's tensor files, as a module of functions."""

from __future__ import annotations

import os
from typing import Any

from numpy.typing import NDArray

from djpt.description.tensor_files import read_tensors, write_tensors
from djpt.errors import ArgumentError

__all__ = ["read", "size_fmt", "write"]

UNITS = ("", "Ki", "Mi", "Gi", "Ti", "Pi", "Yi")


def size_fmt(num: float, suffix: str = "B") -> str:
    """A number of bytes as text with one decimal, such as ``117.7 MiB``."""
    power = 0
    while abs(num) >= 1024 and power < len(UNITS) - 1:
        num, power = num / 1024, power + 1
    return f"{num:.1f} {UNITS[power]}{suffix}"


def read(filename: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """The tensors of a file by name. Raises `FileError` if it isn't a tensor file."""
    return read_tensors(filename)


def write(filename: str | os.PathLike[str], align: int = 8, **kwargs: Any) -> None:
    """Write the arrays that are given by keywords to a file; a text is written as its bytes.

    Raises:
        ArgumentError: `align` isn't a whole number above 0, as if a dictionary was given without ``**``.
        FileError: see `djpt.description.tensor_files.write_tensors`.
    """
    if not isinstance(align, int) or align < 1:
        raise ArgumentError(f"'align' must be a whole number above 0, found {align!r}; give tensors by keywords")
    write_tensors(filename, kwargs, align)
