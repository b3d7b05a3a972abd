"""Mitsuba's tensor files: named arrays of any shape, such as measured materials, in one file.

A file is little-endian: the text ``tensor_file`` with a zero byte, the version 1.0 as two bytes, the count of fields
(4 bytes); for each field the length of its name (2) and the name, the count of dimensions (2), the number of the type
(1), the offset of the numbers in the file (8), and the dimensions (8 each).
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.files import as_path, read_bytes, writing
from djpt.errors import FileError

__all__ = ["read_tensors", "tensor_fields", "write_tensors"]

HEADER = b"tensor_file\0\x01\x00"
TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float16", "float32", "float64")
"""The types of numbers; their numbers in files count from 1."""


@dataclass(frozen=True)
class TensorField:
    """The position of a tensor in a file."""

    dtype: str
    """The type of its numbers, in NumPy's words."""
    offset: int
    """The number of bytes before it."""
    shape: tuple[int, ...]

    def read(self, data: bytes) -> NDArray[Any]:
        """A copy of the tensor in the bytes of its file."""
        count = int(np.prod(self.shape, dtype=np.int64))
        numbers = np.frombuffer(data, np.dtype(self.dtype).newbyteorder("<"), count, self.offset)
        return numbers.astype(self.dtype).reshape(self.shape)


def tensor_fields(path: str | os.PathLike[str]) -> tuple[dict[str, TensorField], bytes]:
    """The fields of a tensor file by name, and the bytes of the file.

    Raises:
        FileError: there is no such file, it isn't a tensor file, or it ends too early.
    """
    data = read_bytes(path)
    if not data.startswith(HEADER):
        raise FileError(f"'{path}' isn't a tensor file of version 1.0")
    place = len(HEADER)

    def take(layout: str) -> tuple[Any, ...]:
        nonlocal place
        found = struct.unpack_from("<" + layout, data, place)
        place += struct.calcsize("<" + layout)
        return found

    fields = {}
    try:
        for _ in range(*take("I")):
            (length,) = take("H")
            name = take(f"{length}s")[0].decode()
            dimensions, kind = take("HB")
            if not 1 <= kind <= len(TYPES):
                raise FileError(f"'{path}': the field '{name}' has numbers of an unknown type, number {kind}")
            (offset,) = take("Q")
            field = TensorField(TYPES[kind - 1], offset, take(f"{dimensions}Q"))
            size = np.dtype(field.dtype).itemsize
            for extent in field.shape:
                size *= extent
            if offset + size > len(data):
                raise FileError(f"'{path}' ends within the field '{name}'")
            fields[name] = field
    except (struct.error, UnicodeDecodeError):
        raise FileError(f"'{path}' ends within the list of its fields") from None
    return fields, data


def read_tensors(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """The tensors of a file by name. Raises `FileError` as `tensor_fields` does."""
    fields, data = tensor_fields(path)
    return {name: field.read(data) for name, field in fields.items()}


def write_tensors(path: str | os.PathLike[str], tensors: dict[str, Any], align: int = 8) -> int:
    """Write tensors to a file and return its size in bytes.

    Args:
        path: the file.
        tensors: arrays of numbers by name; a text becomes its bytes.
        align: numbers start at a multiple of so many bytes.

    Raises:
        FileError: an array holds no numbers, or the file can't be written.
    """
    arrays = {name: as_numbers(name, value) for name, value in tensors.items()}
    size = len(HEADER) + 4 + sum(2 + len(name.encode()) + 11 + 8 * array.ndim for name, array in arrays.items())
    head, body = HEADER + struct.pack("<I", len(arrays)), b""
    for name, array in arrays.items():
        place = size + len(body)
        body += bytes(-place % align)
        label = name.encode()
        head += struct.pack("<H", len(label)) + label
        head += struct.pack("<HBQ", array.ndim, TYPES.index(array.dtype.name) + 1, size + len(body))
        head += struct.pack(f"<{array.ndim}Q", *array.shape)
        body += array.astype(array.dtype.newbyteorder("<")).tobytes()
    with writing(as_path(path)) as temporary:
        temporary.write_bytes(head + body)
    return len(head) + len(body)


def as_numbers(name: str, value: Any) -> NDArray[Any]:
    """The numbers of a tensor that is to be written, or the bytes of a text."""
    array = np.frombuffer(value.encode(), np.uint8) if isinstance(value, str) else np.asarray(value)
    if array.dtype.name not in TYPES:
        raise FileError(f"the field '{name}' must hold numbers, found {array.dtype}; possible: {', '.join(TYPES)}")
    return array
