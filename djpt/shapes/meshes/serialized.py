"""The reader of Mitsuba's compressed binary meshes.

A file holds meshes one after the other and ends with the list of their offsets and their number. Each
has a header of its own (magic number, version), then a zlib stream: flags, a name (version 4), counts,
and plain arrays. Numbers are little endian. The format is described with Mitsuba's `serialized` plugin.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.limits import MAX_NAME
from djpt.errors import SceneError
from djpt.shapes.meshes.data import MeshData, check_indices

__all__ = ["read_serialized"]

MAGIC = 0x041C
NORMALS, TEXCOORDS, COLORS, DOUBLE = 0x1, 0x2, 0x8, 0x2000

CHUNK = 1 << 20
"""Bytes that are handed to the decompressor at a time."""

MAX_RATIO, SLACK = 1040, 1 << 17
"""Largest ratio by which DEFLATE shrinks data: larger counts are wrong, and are refused before reading."""


def read_serialized(data: bytes, where: str, shape_index: int = 0) -> MeshData:
    """Read one of the meshes in a `serialized` file of version 3 or 4.

    As in Mitsuba, vertex colours and the flag for flat shading (0x10) are ignored.

    Args:
        data: the file's contents.
        where: names the file in messages.
        shape_index: the number of the mesh, counted from 0.

    Raises:
        SceneError: not such a file, no such mesh, or the file is cut short.
    """
    version = read_version(data, 0, where)
    offset = mesh_offset(data, version, shape_index, where) if shape_index else 0
    read_version(data, offset, where)
    stream = Stream(data, offset + 4, where)
    (flags,) = struct.unpack("<I", stream.take(4, "its flags"))
    if version == 4:
        length = 0
        while stream.take(1, "its name") != b"\0":
            length += 1
            if length > MAX_NAME:
                raise SceneError(f"{where}: the name of the mesh has more than {MAX_NAME} bytes")
    vertex_count, face_count = struct.unpack("<QQ", stream.take(16, "its counts"))
    number = "<f8" if flags & DOUBLE else "<f4"

    def vertices(width: int, what: str) -> NDArray[np.float32]:
        values = stream.array(number, vertex_count * width, what)
        with np.errstate(over="ignore"):
            return values.reshape(-1, width).astype(np.float32)

    mesh = MeshData(vertices(3, "vertex positions"), np.zeros((0, 3), np.uint32))
    if flags & NORMALS:
        mesh.normals = vertices(3, "vertex normals")
    if flags & TEXCOORDS:
        mesh.texcoords = vertices(2, "texture coordinates")
    if flags & COLORS:
        vertices(3, "vertex colours")
    wide = "<u8" if vertex_count > 0xFFFFFFFF else "<u4"
    indices = stream.array(wide, face_count * 3, "faces").reshape(-1, 3)
    check_indices(indices, vertex_count, where)
    mesh.indices = indices.astype(np.uint32)
    return mesh


def read_version(data: bytes, offset: int, where: str) -> int:
    """Read the version in the header at `offset`."""
    if offset + 4 > len(data):
        raise SceneError(f"{where}, byte {len(data)}: the file is cut short: no header at byte {offset}")
    magic, version = struct.unpack_from("<HH", data, offset)
    if magic != MAGIC:
        raise SceneError(
            f"{where}, byte {offset}: not a 'serialized' mesh: it begins with {magic:#06x}, not {MAGIC:#06x}"
        )
    if version not in (3, 4):
        raise SceneError(f"{where}, byte {offset + 2}: unknown version {version}; possible: 3, 4")
    return int(version)


def mesh_offset(data: bytes, version: int, shape_index: int, where: str) -> int:
    """Read from the list at the end of the file where a mesh begins."""
    (count,) = struct.unpack_from("<I", data, len(data) - 4)
    size, code = (8, "<Q") if version == 4 else (4, "<I")
    start = len(data) - 4 - size * count
    if start < 0:
        raise SceneError(f"{where}: the list of meshes at its end is damaged: it should have {count} entries")
    if shape_index >= count:
        raise SceneError(f"{where}: 'shape_index' {shape_index} is out of range: the file has {count} meshes")
    offset = int(struct.unpack_from(code, data, start + size * shape_index)[0])
    if offset > start:
        raise SceneError(f"{where}: the list of meshes at its end is damaged: mesh {shape_index} at byte {offset}")
    return offset


class Stream:
    """A zlib stream that is decompressed as far as it is asked for."""

    def __init__(self, data: bytes, start: int, where: str) -> None:
        self._inflate, self._where = zlib.decompressobj(), where
        self._input = memoryview(data)[start:]
        self._ready = bytearray()
        self._position = 0

    def take(self, size: int, what: str) -> bytes:
        """Take the next `size` bytes; `what` names them in messages."""
        left = len(self._input) + len(self._inflate.unconsumed_tail)
        if size > MAX_RATIO * left + len(self._ready) + SLACK:
            raise SceneError(f"{self._where}: the file is cut short within {what}, which should have {size} bytes")
        while len(self._ready) - self._position < size and not self._inflate.eof:
            del self._ready[: self._position]
            self._position = 0
            piece = self._inflate.unconsumed_tail or self._input[:CHUNK]
            if not self._inflate.unconsumed_tail:
                self._input = self._input[CHUNK:]
            if not len(piece):
                self._ready += self._inflate.flush()
                break
            try:
                # At most what is asked for, so that a small file can't fill the memory.
                self._ready += self._inflate.decompress(piece, max(size - len(self._ready), 4096))
            except zlib.error as error:
                raise SceneError(f"{self._where}: damaged within {what}: {error}") from None
        if len(self._ready) - self._position < size:
            raise SceneError(f"{self._where}: the file is cut short within {what}")
        result = bytes(memoryview(self._ready)[self._position : self._position + size])
        self._position += size
        return result

    def array(self, code: str, count: int, what: str) -> NDArray[Any]:
        """Take the next `count` numbers of the type `code`; `what` names them in messages."""
        return np.frombuffer(self.take(count * np.dtype(code).itemsize, what), code)
