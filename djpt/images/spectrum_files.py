"""Spectra in text files."""

from __future__ import annotations

import os

from djpt.errors import FileError

__all__ = ["read_pairs"]


def read_pairs(filename: str | os.PathLike[str]) -> tuple[list[float], list[float]]:
    """Wavelengths and values in a text file (spd): two numbers a line, the rest of a line after # is a comment.

    Raises:
        FileError: The file can't be read, or a line has other than two numbers.
    """
    name = os.fspath(filename)
    try:
        with open(name, encoding="utf-8") as file:
            lines = [line.split("#")[0].split() for line in file]
    except OSError as error:
        raise FileError(f"can't read '{name}': {error.strerror}") from None
    except UnicodeError:
        raise FileError(f"can't read '{name}': it isn't a text file") from None
    wavelengths, values = [], []
    for number, line in enumerate(lines, 1):
        if not line:
            continue
        try:
            wavelength, value = map(float, line)
        except ValueError:
            raise FileError(f"'{name}', line {number}: must be two numbers, found {line}") from None
        wavelengths.append(wavelength)
        values.append(value)
    return wavelengths, values
