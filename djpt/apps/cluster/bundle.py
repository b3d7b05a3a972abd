"""Bundles: a scene together with its files, as sent to workers."""

from __future__ import annotations

import hashlib
import pickle
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import djpt
from djpt.core.files import read_bytes, shortened, writing
from djpt.description.named_files import named_files, with_files
from djpt.errors import FileError, SceneError
from djpt.scene.scene import Scene

__all__ = ["Bundle"]


@dataclass(frozen=True)
class Bundle:
    """A description and the contents of the files that it names."""

    key: str
    """A hash of the description and the files."""
    description: bytes
    """The description, pickled: workers trust whoever sends them tasks, as `dask.distributed` requires."""
    files: Mapping[str, tuple[str, bytes]]
    """By the name in the description: the file's name here, a hash with its extension, and its contents."""

    @classmethod
    def of(cls, description: Mapping[str, Any]) -> Bundle:
        """Pack a description.

        Raises:
            SceneError: It holds objects that can't be sent, such as plugins that are already loaded.
            FileError: A file can't be read.
        """
        try:
            packed = pickle.dumps(description)
        except Exception as error:  # whatever an object raises that can't be pickled
            raise SceneError(f"the scene can't be sent to workers: {error}; describe it as a dict or a file") from None
        files = {}
        for name, path in named_files(description).items():
            contents = read_bytes(path)
            files[name] = (named(contents, path.suffix), contents)
        total = hashlib.blake2b(packed, digest_size=16)
        for name, (stored, _) in sorted(files.items()):
            total.update(f"{name}\0{stored}\0".encode())
        return cls(total.hexdigest(), packed, files)

    def loaded(self) -> Scene:
        """The scene.

        Its files are written into a new folder that only this user can access, and are deleted once they are read.

        Raises:
            FileError: The contents of a file differ from those that were packed, or can't be written.
            SceneError: The scene is wrong.
        """
        with tempfile.TemporaryDirectory(prefix="djpt-cluster-", ignore_cleanup_errors=True) as folder:
            return djpt.load_dict(self.unpacked(Path(folder)))

    def unpacked(self, folder: Path) -> dict[str, Any]:
        """The description, naming files that are written into a folder.

        Raises:
            FileError: The contents of a file differ from those that were packed, or can't be written.
        """
        places = {}
        for name, (stored, contents) in self.files.items():
            if stored != named(contents, Path(name).suffix):
                raise FileError(f"'{shortened(name)}' was corrupted in transit: its contents don't match their hash")
            with writing(folder / stored) as temporary:
                temporary.write_bytes(contents)
            places[name] = str(folder / stored)
        return with_files(pickle.loads(self.description), places)


def named(contents: bytes, suffix: str) -> str:
    """The name of a file that has some contents: their hash, and an extension."""
    return hashlib.blake2b(contents, digest_size=16).hexdigest() + suffix
