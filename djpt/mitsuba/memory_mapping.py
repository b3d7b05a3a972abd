"""Files that are mapped into memory."""

from __future__ import annotations

import mmap
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.files import as_path
from djpt.description.plugin import Plugin
from djpt.errors import FileError

__all__ = ["MemoryMappedFile"]


class MemoryMappedFile(Plugin):
    """A file as bytes in memory, through `np.array(file, copy=False)` or `file.__array__()`.

    ``MemoryMappedFile(filename, size)`` makes a new file of zeros, ``MemoryMappedFile(filename, array)`` one with the
    bytes of an array; ``MemoryMappedFile(filename, write=False)`` opens a file, which can be changed if `write`.

    Raises:
        FileError: the file can't be opened, or is empty.
    """

    def __init__(
        self, filename: str | os.PathLike[str], size: Any = None, *, write: bool = False, array: Any = None
    ) -> None:
        super().__init__()
        self._path, self._temporary = str(as_path(filename)), False
        array = size if array is None and isinstance(size, np.ndarray) else array
        if isinstance(size, bool):
            size, write = None, size
        count = array.nbytes if array is not None else size
        self._write = write or count is not None
        try:
            if count is not None:
                with open(self._path, "wb") as file:
                    file.truncate(int(count))
            self._map()
        except (OSError, ValueError) as error:
            raise FileError(f"{self._path}: can't be mapped into memory: {error}") from error
        if array is not None:
            self.__array__()[:] = np.ascontiguousarray(array).view(np.uint8).ravel()

    def _map(self) -> None:
        with open(self._path, "r+b" if self._write else "rb") as file:
            self._bytes = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_WRITE if self._write else mmap.ACCESS_READ)

    @staticmethod
    def create_temporary(arg: int, /) -> MemoryMappedFile:
        """A new file of `arg` bytes in the folder for temporary files, which goes when it is no longer used."""
        handle, name = tempfile.mkstemp(prefix="djpt_")
        os.close(handle)
        made = MemoryMappedFile(name, arg)
        made._temporary = True
        return made

    def __del__(self) -> None:
        if getattr(self, "_temporary", False):
            Path(self._path).unlink(missing_ok=True)

    def size(self) -> int:
        """The number of bytes."""
        return len(self._bytes)

    def filename(self) -> str:
        """The path."""
        return self._path

    def can_write(self) -> bool:
        """Whether changes of the bytes are changes of the file."""
        return self._write

    def data(self) -> NDArray[np.uint8]:
        """The bytes."""
        return self.__array__()

    def resize(self, arg: int, /) -> None:
        """Change the number of bytes; arrays of them from before keep the old ones.

        Raises:
            FileError: the file was opened for reading only.
        """
        if not self._write:
            raise FileError(f"{self._path}: a file that was opened for reading can't be resized")
        self._bytes.flush()
        os.truncate(self._path, arg)
        self._map()

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The bytes, not copied unless asked for."""
        view = np.frombuffer(self._bytes, np.uint8)
        view = view if dtype is None else view.astype(dtype)
        return view.copy() if copy else view

    def __repr__(self) -> str:
        return f'{type(self).__name__}[\n  filename = "{self._path}",\n  size = {self.size()}\n]'
