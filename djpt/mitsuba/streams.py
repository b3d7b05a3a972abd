"""Mitsuba's binary streams, which read and write numbers and strings, and its memory-mapped files.

Streams are Python's binary files, too: `djpt.Bitmap`, `Mesh.write_ply` and Python's own functions take them.
"""

from __future__ import annotations

import enum
import io
import os
import struct
import sys
import tempfile
import weakref
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from djpt.core.files import as_path, errors_of_writing
from djpt.core.forms import accessors
from djpt.description.plugin import Plugin
from djpt.errors import FileError

__all__ = ["DummyStream", "FileStream", "MemoryMappedFile", "MemoryStream", "Stream", "ZStream"]


class ByteOrder(enum.Enum):
    """The order in which the bytes of a number follow each other."""

    EBigEndian = 0
    ELittleEndian = 1
    ENetworkByteOrder = 0


NAMES = {ByteOrder.EBigEndian: "big-endian", ByteOrder.ELittleEndian: "little-endian"}


def number(code: str, kind: str) -> tuple[Callable[[Stream], Any], Callable[[Stream, Any], None]]:
    """The methods that read and write a number with the `code` of Python's `struct`."""

    def read(self: Stream) -> Any:
        return struct.unpack(self._mark + code, self.read_exactly(struct.calcsize(code)))[0]

    def write(self: Stream, arg: Any) -> None:
        try:
            data = struct.pack(self._mark + code, arg)
        except struct.error as error:
            raise FileError(f"{self.title}: can't write {arg!r} as {kind}: {error}") from None
        self.write(data)

    read.__doc__ = f"Read {kind}; raises `FileError` at the end of the stream."
    write.__doc__ = f"Write {kind}."
    return read, write


class Stream(Plugin):
    """A sequence of bytes with a position, on top of one of Python's binary files, whose methods it has as well.

    Numbers are little-endian, unless `set_byte_order` says otherwise. After `close` nothing can be read or written.

    Raises:
        FileError: from methods that read or write, if the stream can't, or ends.
    """

    EByteOrder = ByteOrder
    EBigEndian, ELittleEndian = ByteOrder.EBigEndian, ByteOrder.ELittleEndian

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__()
        self._file = file
        self._order = ByteOrder.ELittleEndian

    def __getattr__(self, name: str) -> Any:
        if name == "_file":  # before it is set
            raise AttributeError(name)
        return getattr(self._file, name)

    @property
    def title(self) -> str:
        """The name in messages."""
        return type(self).__name__

    # ---- the whole stream ---------------------------------------------------------------------

    @property
    def file(self) -> IO[bytes]:
        """Python's file; raises `FileError` after `close`."""
        if self._file.closed:
            raise FileError(f"{self.title}: the stream is closed")
        return self._file

    def close(self) -> None:
        """Close the stream; a second call does nothing."""
        self._file.close()

    def flush(self) -> None:
        """Write buffered data to the file."""
        self.file.flush()

    def can_read(self) -> bool:
        """Whether bytes can be read."""
        return not self._file.closed and self._file.readable()

    def can_write(self) -> bool:
        """Whether bytes can be written."""
        return not self._file.closed and self._file.writable()

    readable, writable = can_read, can_write

    def size(self) -> int:
        """The number of bytes."""
        place = self.tell()
        end = self.file.seek(0, os.SEEK_END)
        self.file.seek(place)
        return end

    def tell(self) -> int:
        """The position."""
        return self.file.tell()

    def seek(self, arg: int, whence: int = os.SEEK_SET, /) -> int:
        """Move to a position, which may lie beyond the end; `whence` is that of Python's files."""
        return self.file.seek(arg, whence)

    def skip(self, arg: int, /) -> None:
        """Move by a number of bytes."""
        self.seek(arg, os.SEEK_CUR)

    def truncate(self, arg: int, /) -> None:
        """Truncate the stream to a size, or extend it with zeros; a position beyond the end moves to the end."""
        self._require(self.can_write(), "written")
        place = min(self.tell(), arg)
        missing = arg - self.size()
        if missing > 0:
            self.seek(0, os.SEEK_END)
            self.file.write(bytes(missing))
        else:
            self.file.truncate(arg)
        self.seek(place)

    # ---- bytes and text -------------------------------------------------------------------------

    def read(self, arg: int = -1, /) -> bytes:
        """Read a number of bytes, fewer at the end; all that are left if the number is negative."""
        self._require(self.can_read(), "read")
        return self.file.read(arg)

    def read_exactly(self, count: int) -> bytes:
        """Read a number of bytes; raises `FileError` if the stream ends before."""
        data = self.read(count)
        if len(data) != count:
            raise FileError(f"{self.title}: {count} bytes were to be read, found {len(data)} before the end")
        return data

    def write(self, arg: bytes, /) -> int:
        """Write bytes; returns their number."""
        self._require(self.can_write(), "written")
        return self.file.write(arg)

    def _require(self, can: bool, what: str) -> None:
        if not can:
            raise FileError(f"{self.title}: the stream can't be {what}")

    def read_line(self) -> str:
        """Read a line of text, without its end."""
        self._require(self.can_read(), "read")
        return self.file.readline().decode("latin-1").rstrip("\r\n")

    def write_line(self, arg: str, /) -> None:
        """Write a line of text."""
        self.write(f"{arg}\n".encode())

    def read_string(self) -> str:
        """Read a string: its number of bytes (uint32), then the bytes."""
        return self.read_exactly(self.read_uint32()).decode()

    def write_string(self, arg: str, /) -> None:
        """Write a string: see `read_string`."""
        data = arg.encode()
        self.write_uint32(len(data))
        self.write(data)

    # ---- numbers --------------------------------------------------------------------------------

    @staticmethod
    def host_byte_order() -> ByteOrder:
        """The order of bytes in the memory of this machine."""
        return ByteOrder.ELittleEndian if sys.byteorder == "little" else ByteOrder.EBigEndian

    byte_order, set_byte_order = accessors("_order", "The order of bytes for numbers to come.", ByteOrder)

    @property
    def _mark(self) -> str:
        return "<" if self._order is ByteOrder.ELittleEndian else ">"

    read_int8, write_int8 = number("b", "an int8")
    read_uint8, write_uint8 = number("B", "a uint8")
    read_int16, write_int16 = number("h", "an int16")
    read_uint16, write_uint16 = number("H", "a uint16")
    read_int32, write_int32 = number("i", "an int32")
    read_uint32, write_uint32 = number("I", "a uint32")
    read_int64, write_int64 = number("q", "an int64")
    read_uint64, write_uint64 = number("Q", "a uint64")
    read_single, write_single = number("f", "a float32")
    read_float, write_float = number("f", "a float32")
    read_double, write_double = number("d", "a float64")
    read_bool, write_bool = number("?", "a bool")

    def _state(self) -> dict[str, Any]:
        """What the representation shows while the stream is open."""
        return {
            "host_byte_order": NAMES[self.host_byte_order()],
            "byte_order": NAMES[self._order],
            "can_read": int(self.can_read()),
            "can_write": int(self.can_write()),
        }

    def _place(self) -> dict[str, Any]:
        return {"pos": self.tell(), "size": self.size()}

    def __repr__(self) -> str:
        rows = ["closed"] if self._file.closed else [f"{k} = {v}" for k, v in (self._state() | self._place()).items()]
        return f"{self.title}[\n  " + ",\n  ".join(rows) + "\n]"


class Mode(enum.Enum):
    """How a file is opened."""

    ERead = 0
    EReadWrite = 1
    ETruncReadWrite = 2


MODES = {Mode.ERead: "rb", Mode.EReadWrite: "r+b", Mode.ETruncReadWrite: "w+b"}


class FileStream(Stream):
    """A file on the disk.

    Args:
        p: the path.
        mode: `ERead` (default), `EReadWrite` (of a file that exists), or `ETruncReadWrite` (of a new, empty file).

    Raises:
        FileError: the file can't be opened; and later on, it can't be written, as on a full disk.
    """

    EMode = Mode
    ERead, EReadWrite, ETruncReadWrite = Mode.ERead, Mode.EReadWrite, Mode.ETruncReadWrite

    def __init__(self, p: str | os.PathLike[str], mode: Mode = Mode.ERead) -> None:
        self._path = as_path(p)
        try:
            file = open(self._path, MODES[Mode(mode)])  # noqa: SIM115 - the stream closes it
        except OSError as error:
            raise FileError(f"{self._path}: can't be opened: {error.strerror}") from error
        super().__init__(file)

    def path(self) -> str:
        """The path."""
        return str(self._path)

    def _state(self) -> dict[str, Any]:
        return {"path": f'"{self._path}"'} | super()._state()

    def write(self, arg: bytes, /) -> int:
        with errors_of_writing(self._path):
            return super().write(arg)

    def truncate(self, arg: int, /) -> None:
        with errors_of_writing(self._path):
            super().truncate(arg)

    def seek(self, arg: int, whence: int = os.SEEK_SET, /) -> int:
        if self.can_write():
            self.flush()  # seeking would write what is held back
        return super().seek(arg, whence)

    def flush(self) -> None:
        with errors_of_writing(self._path):
            super().flush()

    def close(self) -> None:
        with errors_of_writing(self._path):
            super().close()


class MemoryStream(Stream):
    """Bytes in memory, empty at first; `capacity` is the number of bytes that are expected."""

    def __init__(self, capacity: int = 512) -> None:
        self._buffer = io.BytesIO()
        super().__init__(self._buffer)
        self._capacity = capacity

    def capacity(self) -> int:
        """The number of bytes that there is room for; it grows with the stream."""
        return max(self._capacity, self.size())

    def owns_buffer(self) -> bool:
        """True: the memory belongs to the stream."""
        return True

    def raw_buffer(self) -> bytes:
        """All bytes."""
        return self._buffer.getvalue()

    def _state(self) -> dict[str, Any]:
        return super()._state() | {"owns_buffer": int(self.owns_buffer()), "capacity": self.capacity()}


class Counter(io.BytesIO):
    """A file that can't be read."""

    def readable(self) -> bool:
        return False


class DummyStream(Stream):
    """A stream that can be written and tells its size, but not be read."""

    def __init__(self) -> None:
        super().__init__(Counter())


class Compression(enum.Enum):
    """The form of compressed bytes."""

    EDeflateStream = 0
    EGZipStream = 1


WINDOW = {Compression.EDeflateStream: zlib.MAX_WBITS, Compression.EGZipStream: zlib.MAX_WBITS | 16}
"""The number that tells zlib the form."""


class Decompressor(io.RawIOBase):
    """A file that decompresses what it reads from a stream."""

    def __init__(self, stream: Stream, window: int) -> None:
        self._stream, self._zlib, self._plain = stream, zlib.decompressobj(window), b""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        while not self._plain and (packed := self._stream.read(io.DEFAULT_BUFFER_SIZE)):
            try:
                self._plain = self._zlib.decompress(packed)
            except zlib.error as error:
                raise FileError(f"ZStream: the bytes can't be decompressed: {error}") from None
        count = min(len(buffer), len(self._plain))
        buffer[:count], self._plain = self._plain[:count], self._plain[count:]
        return count


class Compressor(io.RawIOBase):
    """A file that compresses what it writes to a stream."""

    def __init__(self, stream: Stream, window: int, level: int) -> None:
        self._stream, self._zlib, self._written = stream, zlib.compressobj(level, zlib.DEFLATED, window), False

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self._written = True
        self._stream.write(self._zlib.compress(data))
        return len(data)

    def hand_on(self, how: int) -> None:
        """Write what zlib holds back."""
        if self._written and self._stream.can_write():
            self._stream.write(self._zlib.flush(how))

    def close(self) -> None:
        if not self.closed:
            self.hand_on(zlib.Z_FINISH)
        super().close()


class ZStream(Stream):
    """Compressed writing to, and reading from, another stream, which stays open; it has no positions.

    Args:
        child_stream: the stream of compressed bytes, which are complete after `close` or when the `ZStream` goes.
        stream_type: `EDeflateStream` (default) or `EGZipStream`.
        level: from 0 (not at all) to 9 (as small as possible); -1 chooses.

    Raises:
        FileError: from methods that read: the bytes aren't compressed in this form; from those that need a position.
    """

    EStreamType = Compression
    EDeflateStream, EGZipStream = Compression.EDeflateStream, Compression.EGZipStream

    def __init__(
        self, child_stream: Stream, stream_type: Compression = Compression.EDeflateStream, level: int = -1
    ) -> None:
        self._child = child_stream
        window = WINDOW[Compression(stream_type)]
        self._compressor = Compressor(child_stream, window, level)
        super().__init__(cast(IO[bytes], io.BufferedRWPair(Decompressor(child_stream, window), self._compressor)))

    def child_stream(self) -> Stream:
        """The stream of compressed bytes."""
        return self._child

    def can_read(self) -> bool:
        return super().can_read() and self._child.can_read()

    def can_write(self) -> bool:
        return super().can_write() and self._child.can_write()

    readable, writable = can_read, can_write

    def flush(self) -> None:
        """Write out what is held back, which compresses a little less."""
        super().flush()
        self._compressor.hand_on(zlib.Z_SYNC_FLUSH)
        self._child.flush()

    def tell(self) -> int:
        raise FileError(f"{self.title}: compressed bytes have no positions")

    def seek(self, arg: int, whence: int = os.SEEK_SET, /) -> int:
        return self.tell()

    def _place(self) -> dict[str, Any]:
        return {"child_stream": repr(self._child).replace("\n", "\n  ")}


class MemoryMappedFile(Plugin):
    """A file as bytes in memory, through `np.array(file, copy=False)` or `file.__array__()`: a `numpy.memmap`.

    ``MemoryMappedFile(filename, size)`` makes a new file of zeros, ``MemoryMappedFile(filename, array)`` one with the
    bytes of an array; ``MemoryMappedFile(filename, write=False)`` opens a file, which can be changed if `write`.

    Raises:
        FileError: the file can't be opened, or is empty.
    """

    def __init__(
        self, filename: str | os.PathLike[str], size: Any = None, *, write: bool = False, array: Any = None
    ) -> None:
        super().__init__()
        self._path = as_path(filename)
        if isinstance(size, bool):
            size, write = None, size
        content = size if array is None and isinstance(size, np.ndarray) else array
        count = size if content is None else content.nbytes
        self._mode: Any = "r" if count is None and not write else "r+"
        self._map("w+" if count is not None else self._mode, count)
        if content is not None:
            self._bytes[:] = np.ascontiguousarray(content).view(np.uint8).ravel()

    def _map(self, mode: Any, count: int | None) -> None:
        try:
            self._bytes = np.memmap(self._path, np.uint8, mode, shape=count)
        except (OSError, ValueError) as error:
            raise FileError(f"{self._path}: can't be mapped into memory: {error}") from error

    @staticmethod
    def create_temporary(arg: int, /) -> MemoryMappedFile:
        """A new file of `arg` bytes in the folder for temporary files, which goes when it is no longer used."""
        handle, name = tempfile.mkstemp(prefix="djpt_")
        os.close(handle)
        made = MemoryMappedFile(name, arg)
        weakref.finalize(made, Path(name).unlink, missing_ok=True)
        return made

    def size(self) -> int:
        """The number of bytes."""
        return len(self._bytes)

    def filename(self) -> str:
        """The path."""
        return str(self._path)

    def can_write(self) -> bool:
        """Whether changes of the bytes are changes of the file."""
        return self._bytes.flags.writeable

    def data(self) -> NDArray[np.uint8]:
        """The bytes."""
        return self._bytes

    def resize(self, arg: int, /) -> None:
        """Change the number of bytes; arrays of them from before keep the old ones.

        Raises:
            FileError: the file was opened for reading only.
        """
        if not self.can_write():
            raise FileError(f"{self._path}: a file that was opened for reading can't be resized")
        self._bytes.flush()
        os.truncate(self._path, arg)
        self._map(self._mode, arg)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The bytes, not copied unless asked for."""
        return np.array(self._bytes, dtype, copy=copy)

    def __repr__(self) -> str:
        return f'{type(self).__name__}[\n  filename = "{self._path}",\n  size = {self.size()}\n]'
