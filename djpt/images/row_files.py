"""Image files that are written row by row, so that the image needn't be in memory.

The pixels are those that `djpt.write` writes, bit for bit. Formats that can't be written from top to bottom get the
whole image at the end.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from djpt.core.files import errors_of_writing, replacing
from djpt.images.exr import FILLER, OF_XYZ, ORDER, usual_names
from djpt.images.formats import FORMATS, Hdr, Labels, Npy, Opened, Pfm, Shape
from djpt.images.png16 import COLOR_TYPES, SIGNATURE, SRGB, chunk, text_chunk
from djpt.images.srgb import to_srgb8

__all__ = ["is_streamed", "writing_rows"]

Pixels = npt.NDArray[np.float32]


class RowFile(Protocol):
    """A file that is being written."""

    def add(self, rows: Pixels) -> None:
        """Write the next rows, (rows, width, channels) of linear values."""

    def close(self, labels: Labels) -> None:
        """Finish the file when all rows are written; `labels` as at the beginning, but with metadata as they are now.

        Values may have become a little longer, none may be new.
        """

    def release(self) -> None:
        """Let the file go, finished or not."""


@contextlib.contextmanager
def writing_rows(target: Path, shape: Shape, labels: Labels) -> Iterator[RowFile]:
    """A file to which rows are written; it takes its place when all went well, and leaves an old one if not.

    What is raised while rows are computed passes unchanged; what `add` and `close` can't do raises `FileError`.
    """
    with replacing(target) as temporary:
        with errors_of_writing(target):
            file = STREAMED.get(target.suffix.lower(), Whole)(temporary, shape, labels)
        guarded = Guarded(target, file)
        try:
            yield guarded
        finally:
            guarded.release()


def is_streamed(target: Path) -> bool:
    """True if files of this name are written from top to bottom, without the whole image in memory."""
    return target.suffix.lower() in STREAMED


class Guarded:
    """A file whose errors name its path."""

    def __init__(self, target: Path, file: RowFile) -> None:
        self._target, self._file = target, file

    def add(self, rows: Pixels) -> None:
        with errors_of_writing(self._target):
            self._file.add(rows)

    def close(self, labels: Labels) -> None:
        with errors_of_writing(self._target):
            self._file.close(labels)

    def release(self) -> None:
        # What a full disk didn't take is tried once more at the end: the error that matters has been raised.
        with contextlib.suppress(OSError):
            self._file.release()


# ---- formats -------------------------------------------------------------------------------


class Exr:
    """OpenEXR, with the attributes that `djpt.write` gives it."""

    def __init__(self, path: Path, shape: Shape, labels: Labels) -> None:
        height, width, channels = shape
        names = tuple(labels.channels) if labels.channels is not None else usual_names(channels)
        self._order = {ORDER: ",".join(names)}
        self._file = ExrRows(path, width, height, names, {**labels.metadata, **self._order})

    def add(self, rows: Pixels) -> None:
        self._file.add(rows)

    def close(self, labels: Labels) -> None:
        self._file.finish({**labels.metadata, **self._order})

    def release(self) -> None:
        self._file.release()


class Png(Opened):
    """PNG of 8 bits per channel, each row as the difference to the one above."""

    def __init__(self, path: Path, shape: Shape, labels: Labels) -> None:
        height, width, channels = shape
        head = struct.pack(">IIBBBBB", width, height, 8, COLOR_TYPES[channels], 0, 0, 0)
        super().__init__(path, SIGNATURE + chunk(b"IHDR", head) + SRGB)
        self._deflate = zlib.compressobj(6)
        self._above = np.zeros(width * channels, np.uint8)

    def add(self, rows: Pixels) -> None:
        lines = to_srgb8(rows).reshape(len(rows), -1)
        coded = np.full((len(lines), lines.shape[1] + 1), 2, np.uint8)  # 2: the filter "up"
        coded[0, 1:] = lines[0] - self._above
        coded[1:, 1:] = lines[1:] - lines[:-1]
        self._above = lines[-1].copy()
        self._write(self._deflate.compress(coded.data))

    def close(self, labels: Labels) -> None:
        self._write(self._deflate.flush())
        texts = b"".join(text_chunk(name, text) for name, text in labels.metadata.items())
        self._file.write(texts + chunk(b"IEND", b""))
        super().close(labels)

    def _write(self, packed: bytes) -> None:
        if packed:
            self._file.write(chunk(b"IDAT", packed))


class Whole:
    """Any other format: the image is kept until it is complete."""

    def __init__(self, path: Path, shape: Shape, labels: Labels) -> None:
        self._path, self._image, self._row = path, np.empty(shape, np.float32), 0

    def add(self, rows: Pixels) -> None:
        self._image[self._row : self._row + len(rows)] = rows
        self._row += len(rows)

    def close(self, labels: Labels) -> None:
        FORMATS[self._path.suffix.lower()].encode(self._path, self._image, labels)

    def release(self) -> None:
        pass


STREAMED: dict[str, Callable[[Path, Shape, Labels], RowFile]] = {
    ".exr": Exr,
    ".png": Png,
    ".hdr": Hdr,
    ".pfm": Pfm,
    ".npy": Npy,
}
"""The formats that are written from top to bottom."""


# ---- OpenEXR (*OpenEXR File Layout*, 2.0) ----------------------------------------------------


BLOCK = 16
"""The rows of a block, by the definition of ZIP."""

LEVEL = 4
"""The level of Deflate, as OpenEXR's own: higher ones take far longer for little."""

ZIP, FLOAT = 3, 2
"""The numbers by which the format calls its compression and the type of its channels."""

VERSION, LONG_NAMES = 2, 0x400
"""The format's version, and the flag of files with names of more than 31 letters."""

ROOM = 128
"""Bytes by which the attributes may grow until the file is closed."""

THREADS = min(8, os.cpu_count() or 1)


class ExrRows:
    """A file of scan lines.

    Args:
        path: Overwritten.
        width, height: In pixels.
        names: Of the channels, in the order of the pixels' last axis.
        attributes: Texts. `finish` may give others of up to 128 bytes more.
    """

    def __init__(
        self, path: Path, width: int, height: int, names: Sequence[str], attributes: Mapping[str, str]
    ) -> None:
        self._size, self._names = (width, height), tuple(names)
        # The format asks for channels by name.
        self._order = sorted(range(len(names)), key=lambda i: names[i].encode())
        header = self._header(attributes)
        self._header_size = len(header) + len(attribute(FILLER, "string", b"")) + ROOM
        self._offsets: list[int] = []
        self._rest: Pixels = np.empty((0, width, len(names)), np.float32)
        self._begun: deque[tuple[int, Future[bytes]]] = deque()
        self._file = path.open("wb")
        self._threads = ThreadPoolExecutor(THREADS)
        blocks = -(-height // BLOCK)
        self._file.seek(self._header_size + 8 * blocks)

    def add(self, rows: Pixels) -> None:
        """Write the next rows, (rows, width, channels)."""
        rows = np.concatenate([self._rest, rows])
        whole = len(rows) // BLOCK * BLOCK
        for start in range(0, whole, BLOCK):
            self._begin(rows[start : start + BLOCK])
        self._rest = rows[whole:].copy()

    def finish(self, attributes: Mapping[str, str]) -> None:
        """Finish the file when all rows are written."""
        if len(self._rest):
            self._begin(self._rest)
        while self._begun:
            self._write_oldest()
        header = self._header(attributes)
        room = self._header_size - len(header) - len(attribute(FILLER, "string", b""))
        if room < 0:
            raise ValueError("the metadata have become too long")
        self._file.seek(0)
        self._file.write(header[:-1] + attribute(FILLER, "string", b" " * room) + b"\0")
        self._file.write(struct.pack(f"<{len(self._offsets)}Q", *self._offsets))
        self.release()

    def release(self) -> None:
        """Let the file go, finished or not."""
        self._threads.shutdown(cancel_futures=True)
        self._file.close()

    def _begin(self, rows: Pixels) -> None:
        """Let a thread compress a block, of which there are few at a time."""
        number = len(self._offsets) + len(self._begun)
        self._begun.append((number * BLOCK, self._threads.submit(compressed, rows, self._order)))
        while len(self._begun) > 2 * THREADS:
            self._write_oldest()

    def _write_oldest(self) -> None:
        row, block = self._begun.popleft()
        data = block.result()
        self._offsets.append(self._file.tell())
        self._file.write(struct.pack("<ii", row, len(data)))
        self._file.write(data)

    def _header(self, attributes: Mapping[str, str]) -> bytes:
        width, height = self._size
        names = [self._names[i].encode() for i in self._order]
        longest = max(len(name) for name in (*names, *(name.encode() for name in attributes)))
        channels = b"".join(name + b"\0" + struct.pack("<iB3xii", FLOAT, 0, 1, 1) for name in names)
        window = struct.pack("<4i", 0, 0, width - 1, height - 1)
        parts = [
            struct.pack("<ii", 20000630, VERSION | (LONG_NAMES if longest > 31 else 0)),
            attribute("channels", "chlist", channels + b"\0"),
            attribute("compression", "compression", bytes([ZIP])),
            attribute("dataWindow", "box2i", window),
            attribute("displayWindow", "box2i", window),
            attribute("lineOrder", "lineOrder", b"\0"),
            attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
            attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
            attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
        ]
        if self._names[:3] == ("X", "Y", "Z"):
            parts.append(attribute("chromaticities", "chromaticities", struct.pack("<8f", *OF_XYZ)))
        parts += [attribute(name, "string", text.encode()) for name, text in attributes.items()]
        return b"".join(parts) + b"\0"


def attribute(name: str, kind: str, value: bytes) -> bytes:
    """An attribute of the header."""
    return b"%s\0%s\0%s%s" % (name.encode(), kind.encode(), struct.pack("<i", len(value)), value)


def compressed(rows: Pixels, order: Sequence[int]) -> bytes:
    """A block of rows: in each, the numbers of one channel after those of the other, in an `order`."""
    data = np.ascontiguousarray(rows.transpose(0, 2, 1)[:, order], "<f4").view(np.uint8).ravel()
    halves = np.concatenate([data[::2], data[1::2]])
    halves[1:] = halves[1:] - halves[:-1] + np.uint8(128)
    packed = zlib.compress(halves.data, LEVEL)
    # A block that isn't smaller is stored as it is.
    return packed if len(packed) < len(data) else data.tobytes()
