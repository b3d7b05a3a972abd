"""Spectra in text files."""

from __future__ import annotations

import os

from djpt.core.files import as_path, read_bytes
from djpt.errors import FileError

__all__ = ["read_pairs"]


def read_pairs(filename: str | os.PathLike[str]) -> tuple[list[float], list[float]]:
    """Wavelengths and values in a text file (spd): two numbers a line, the rest of a line after # is a comment.

    Raises:
        FileError: The file can't be read, or a line has other than two numbers.
    """
    name = as_path(filename)
    try:
        lines = [line.split("#")[0].split() for line in read_bytes(name).decode("utf-8").splitlines()]
    except UnicodeError:
        raise FileError(f"can't read '{name}': it isn't a text file") from None
    wavelengths, values = [], []
    for number, line in enumerate(lines, 1):
        if not line:
            continue
        try:
            wavelength, value = map(float, line)
        except ValueError:
            raise FileError(f"'{name}', line {number}: must be two numbers, a wavelength and a value") from None
        wavelengths.append(wavelength)
        values.append(value)
    return wavelengths, values
