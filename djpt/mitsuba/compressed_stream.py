"""Streams that compress what passes through them."""

from __future__ import annotations

import enum
import zlib
from typing import Any

from djpt.errors import FileError
from djpt.mitsuba.streams import Stream

__all__ = ["ZStream"]


class Kind(enum.Enum):
    """The form of compressed bytes."""

    EDeflateStream = 0
    EGZipStream = 1


BITS = {Kind.EDeflateStream: zlib.MAX_WBITS, Kind.EGZipStream: zlib.MAX_WBITS | 16}
"""The number that tells zlib the form."""
CHUNK = 1 << 15
"""The number of compressed bytes that are read at once."""


class ZStream(Stream):
    """Compressed writing to, and reading from, another stream; bytes are on their way until `close` or `flush`.

    Args:
        child_stream: the stream of compressed bytes.
        stream_type: `EDeflateStream` (default) or `EGZipStream`.
        level: from 0 (not at all) to 9 (as small as possible); -1 chooses.

    Raises:
        FileError: from methods that read: the bytes aren't compressed in this form.
    """

    EStreamType = Kind
    EDeflateStream, EGZipStream = Kind.EDeflateStream, Kind.EGZipStream

    def __init__(self, child_stream: Stream, stream_type: Kind = Kind.EDeflateStream, level: int = -1) -> None:
        super().__init__()
        bits = BITS[Kind(stream_type)]
        self._child: Stream | None = child_stream
        self._packer = zlib.compressobj(level, zlib.DEFLATED, bits)
        self._unpacker = zlib.decompressobj(bits)
        self._plain, self._written = b"", False

    def child_stream(self) -> Any:
        """The stream of compressed bytes, None after `close`."""
        return self._child

    def can_read(self) -> bool:
        return self._child is not None and self._child.can_read()

    def can_write(self) -> bool:
        return self._child is not None and self._child.can_write()

    readable, writable = can_read, can_write

    def seekable(self) -> bool:
        """False: compressed bytes have no positions."""
        return False

    def read(self, arg: int = -1, /) -> bytes:
        self._require(self.can_read(), "read")
        assert self._child is not None
        while arg < 0 or len(self._plain) < arg:
            packed = self._child.read(CHUNK)
            if not packed:
                break
            try:
                self._plain += self._unpacker.decompress(packed)
            except zlib.error as error:
                raise FileError(f"{self.title}: the bytes can't be decompressed: {error}") from None
        end = len(self._plain) if arg < 0 else arg
        data, self._plain = self._plain[:end], self._plain[end:]
        return data

    def write(self, arg: bytes, /) -> int:
        self._require(self.can_write(), "written")
        assert self._child is not None
        self._child.write(self._packer.compress(arg))
        self._written = True
        return len(arg)

    def flush(self) -> None:
        """Write out what is held back; compresses a little less."""
        if self._child is not None and self._written:
            self._child.write(self._packer.flush(zlib.Z_SYNC_FLUSH))
            self._child.flush()

    def close(self) -> None:
        """Complete the compressed bytes; the other stream stays open."""
        if self._child is not None and self._written and self._child.can_write():
            self._child.write(self._packer.flush())
        self._child = None

    def __del__(self) -> None:
        if "_child" in self.__dict__:
            self.close()

    def readline(self) -> bytes:
        line = b""
        while not line.endswith(b"\n"):
            byte = self.read(1)
            if not byte:
                break
            line += byte
        return line

    @property
    def closed(self) -> bool:
        return self._child is None

    def __repr__(self) -> str:
        return f"{self.title}[\n  child_stream = {self._child!r}\n]"
