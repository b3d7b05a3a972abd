"""Mitsuba's tensor files: as an object, and by functions, the names of `djpt.tensor_io`."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
from numpy.typing import NDArray

from djpt.description.tensor_files import read_tensors, tensor_fields, write_tensors
from djpt.errors import ArgumentError, FileError, near_miss
from djpt.images.structs import Type
from djpt.mitsuba.misc import mem_string

__all__ = ["TensorFile", "read", "size_fmt", "write"]

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


@dataclass(frozen=True, repr=False)
class StoredTensor:
    """A tensor of a file."""

    dtype: Type
    """The type of its numbers."""
    offset: int
    """The number of bytes before it in the file."""
    extents: tuple[int, ...]
    numbers: NDArray[Any] = field(compare=False)

    @property
    def shape(self) -> list[int]:
        """The number of entries along each dimension."""
        return list(self.extents)

    def to(self, dtype: Any) -> Any:
        """The tensor as one of Dr.Jit.

        Raises:
            ArgumentError: `dtype` isn't a type of tensors, or one of other numbers than these.
        """
        if not dr.is_tensor_v(dtype):
            raise ArgumentError(f"to(): expected a type of Dr.Jit's tensors, found {dtype}")
        wanted = dr.type_v(dtype).name.lower()
        if wanted != self.dtype.name.lower():
            raise ArgumentError(f"to(): the tensor holds {self.dtype.name.lower()}, not {wanted}")
        return dtype(self.numbers)

    def lines(self) -> list[str]:
        """The entries of `repr`."""
        return [f"dtype = {self.dtype.name.lower()},", f"offset = {self.offset},", f"shape = {self.shape}"]

    def __repr__(self) -> str:
        return "\n".join(["TensorFile.Field[", *(f"  {line}" for line in self.lines()), "]"])


class TensorFile:
    """The tensors of a file by name: ``file["alpha"].to(TensorXf)``. See `read` for all at once."""

    Field = StoredTensor

    def __init__(self, path: str | os.PathLike[str], /) -> None:
        """Read a file. Raises `FileError` if it isn't a tensor file."""
        found, data = tensor_fields(path)
        self._path, self._size = str(path), len(data)
        self._fields = {
            name: StoredTensor(Type.of(field.dtype), field.offset, field.shape, field.read(data))
            for name, field in found.items()
        }

    def filename(self) -> str:
        """The path that was given."""
        return self._path

    def size(self) -> int:
        """The size of the file in bytes."""
        return self._size

    def __contains__(self, name: str, /) -> bool:
        return name in self._fields

    def __getitem__(self, name: str, /) -> StoredTensor:
        if name not in self._fields:
            raise FileError(f"'{self._path}' has no field '{name}'{near_miss(name, self._fields)}")
        return self._fields[name]

    def __repr__(self) -> str:
        entries = [
            "\n".join([f'    "{name}" => [', *(f"      {line}" for line in field.lines()), "    ]"])
            for name, field in sorted(self._fields.items(), key=lambda entry: entry[1].offset)
        ]
        head = [f'  filename = "{self._path}",', f"  size = {mem_string(self._size)},", "  fields = {"]
        return "\n".join(["TensorFile[", *head, ",\n".join(entries), "  }", "]"])
