"""Files of named tensors, in Mitsuba's format.

A header names the tensors: its mark, the version (1, 0), the number of tensors, and of each the name, the number of
axes (uint16), the type (uint8, the number of `Struct.Type`), the place in the file and the shape (uint64), all
little-endian.
"""

from __future__ import annotations

import os
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.errors import FileError
from djpt.scripting.memory_mapping import MemoryMappedFile
from djpt.scripting.structs import Struct

__all__ = ["TensorFile", "read", "size_fmt", "write"]

MARK = b"tensor_file\0"
VERSION = (1, 0)


def size_fmt(num: float, suffix: str = "B") -> str:
    """A number of bytes in the largest unit in which it is at least 1, such as ``4.1 KiB``."""
    for unit in ("", "Ki", "Mi", "Gi", "Ti", "Pi"):
        if abs(num) < 1024:
            return f"{num:3.1f} {unit}{suffix}"
        num /= 1024
    return f"{num:.1f} Ei{suffix}"


def write(filename: str | os.PathLike[str], align: int = 8, **kwargs: Any) -> None:
    """Write tensors, given by name: arrays of numbers, or strings. Each begins at a multiple of `align` bytes.

    Raises:
        FileError: an array isn't one of numbers.
    """
    tensors = {name: as_numbers(name, value) for name, value in kwargs.items()}
    place = len(MARK) + 2 + 4 + sum(entry_size(name, tensor) for name, tensor in tensors.items())
    head, body = MARK + struct.pack("<BBI", *VERSION, len(tensors)), []
    for name, tensor in tensors.items():
        gap = -place % align
        label = name.encode()
        head += struct.pack("<H", len(label)) + label
        head += struct.pack("<HBQ", tensor.ndim, Struct.Type.of(tensor.dtype).value, place + gap)
        head += struct.pack(f"<{tensor.ndim}Q", *tensor.shape)
        body += [bytes(gap), tensor.tobytes()]
        place += gap + tensor.nbytes
    with open(filename, "wb") as file:
        file.write(head + b"".join(body))


def entry_size(name: str, tensor: NDArray[Any]) -> int:
    """The number of bytes that a tensor takes in the header."""
    return 2 + len(name.encode()) + 2 + 1 + 8 + 8 * tensor.ndim


def as_numbers(name: str, value: Any) -> NDArray[Any]:
    """An array to be stored; a string as its bytes."""
    found = np.frombuffer(value.encode(), np.uint8) if isinstance(value, str) else np.asarray(value, order="C")
    if Struct.Type.of(found.dtype) is Struct.Type.Invalid:
        raise FileError(f"tensor_io.write: '{name}' can't be stored: its type is {found.dtype}")
    return found


def read(filename: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """The tensors of a file by name.

    Raises:
        FileError: the file can't be read, or isn't one of tensors.
    """
    file = TensorFile(filename)
    return {name: np.array(field.view()) for name, field in file.fields.items()}


class TensorField:
    """A tensor of a file."""

    def __init__(self, file: TensorFile, type: Any, offset: int, shape: tuple[int, ...]) -> None:
        self._file, self._type, self._offset, self._shape = file, type, offset, shape

    @property
    def dtype(self) -> Any:
        """The type of the numbers, a `Struct.Type`."""
        return self._type

    @property
    def offset(self) -> int:
        """The place in the file, in bytes."""
        return self._offset

    @property
    def shape(self) -> list[int]:
        """The size of each axis."""
        return list(self._shape)

    def view(self) -> NDArray[Any]:
        """The numbers in the memory of the file."""
        count = int(np.prod(self._shape, dtype=np.int64))
        kind = self._type.dtype
        data = self._file.data()[self._offset : self._offset + count * kind.itemsize]
        return data.view(kind).reshape(self._shape)

    def to(self, dtype: type[Any]) -> Any:
        """The numbers as a tensor of Dr.Jit's type `dtype`."""
        return dtype(np.array(self.view()))

    def __repr__(self) -> str:
        return f"TensorFile.Field[{self.listed(2)}\n]"

    def listed(self, indent: int) -> str:
        """The entries of `repr`, each on a line of its own."""
        entries = {"dtype": self._type.name.lower(), "offset": self._offset, "shape": self.shape}
        return ",".join(f"\n{' ' * indent}{name} = {value}" for name, value in entries.items())


class TensorFile(MemoryMappedFile):
    """The tensors of a file, read when they are asked for: ``file["name"]`` is a `TensorFile.Field`.

    Raises:
        FileError: the file can't be read, or isn't one of tensors.
    """

    Field = TensorField

    def __init__(self, arg: str | os.PathLike[str], /) -> None:
        super().__init__(arg)
        self.fields: dict[str, TensorField] = {}
        """The tensors by name."""
        try:
            self._read_header(self.data().tobytes())
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            raise FileError(f"{self._path}: the header of the tensors is damaged: {error}") from error

    def _read_header(self, data: bytes) -> None:
        if not data.startswith(MARK):
            raise FileError(f"{self._path}: this isn't a file of tensors")
        place = len(MARK)

        def unpack(form: str) -> tuple[Any, ...]:
            nonlocal place
            found = struct.unpack_from("<" + form, data, place)
            place += struct.calcsize("<" + form)
            return found

        *version, count = unpack("BBI")
        if tuple(version) != VERSION:
            raise FileError(f"{self._path}: files of tensors of the version {version} can't be read")
        for _ in range(count):
            (length,) = unpack("H")
            (label,) = unpack(f"{length}s")
            axes, kind, offset = unpack("HBQ")
            self.fields[label.decode()] = TensorField(self, Struct.Type(kind), offset, unpack(f"{axes}Q"))

    def __contains__(self, arg: str, /) -> bool:
        return arg in self.fields

    def __getitem__(self, arg: str, /) -> TensorField:
        if arg not in self.fields:
            raise FileError(f"{self._path}: there is no tensor '{arg}'; found: {', '.join(self.fields) or 'none'}")
        return self.fields[arg]

    def __repr__(self) -> str:
        listed = ",".join(f'\n    "{name}" => [{field.listed(6)}\n    ]' for name, field in self.fields.items())
        size = f"{self.size() / 1024:.3g} KiB" if self.size() >= 1024 else f"{self.size()} B"
        return f'TensorFile[\n  filename = "{self._path}",\n  size = {size},\n  fields = {{{listed}\n  }}\n]'
