"""Image files that are written row by row, so that the image needn't be in memory.

The pixels are those that `djpt.write` writes, bit for bit. Formats that can't be written from top to bottom get the
whole image at the end.
"""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from djpt.core.files import errors_of_writing, replacing
from djpt.images.exr import ORDER, usual_names
from djpt.images.exr_rows import ExrRows
from djpt.images.formats import FORMATS, Labels, hdr_header, pfm_header, to_rgbe
from djpt.images.png16 import COLOR_TYPES, SIGNATURE, SRGB, chunk, text_chunk
from djpt.images.srgb import strips, to_srgb8

__all__ = ["RowFile", "is_streamed", "writing_rows"]

Pixels = npt.NDArray[np.float32]
Shape = tuple[int, int, int]
"""Height, width, channels."""


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


class Opened:
    """A file with a header, and rows after it."""

    def __init__(self, path: Path, header: bytes) -> None:
        self._file = path.open("wb")
        self._file.write(header)

    def close(self, labels: Labels) -> None:
        self.release()

    def release(self) -> None:
        self._file.close()


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


class Hdr(Opened):
    """Radiance RGBE."""

    def __init__(self, path: Path, shape: Shape, labels: Labels) -> None:
        super().__init__(path, hdr_header(shape[1], shape[0]))

    def add(self, rows: Pixels) -> None:
        for strip in strips(rows):
            self._file.write(to_rgbe(rows[strip]).data)


class Pfm(Opened):
    """A portable float map, whose last row comes first."""

    def __init__(self, path: Path, shape: Shape, labels: Labels) -> None:
        height, width, channels = shape
        header = pfm_header(width, height, channels)
        super().__init__(path, header)
        self._end = len(header) + 4 * width * height * channels

    def add(self, rows: Pixels) -> None:
        self._end -= rows.nbytes
        self._file.seek(self._end)
        self._file.write(np.ascontiguousarray(rows[::-1], "<f4").data)


class Npy(Opened):
    """NumPy's format."""

    def __init__(self, path: Path, shape: Shape, labels: Labels) -> None:
        super().__init__(path, b"")
        layout = {"descr": "<f4", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._file, layout)

    def add(self, rows: Pixels) -> None:
        self._file.write(np.ascontiguousarray(rows, "<f4").data)


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
