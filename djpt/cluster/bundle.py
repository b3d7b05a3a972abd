"""Bundles: a scene with its files, as it travels to workers."""

from __future__ import annotations

import hashlib
import pickle
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from djpt.description.named_files import named_files, with_files
from djpt.errors import SceneError
from djpt.files import read_bytes, replacing

__all__ = ["Bundle"]


@dataclass(frozen=True)
class Bundle:
    """A description and the contents of the files that it names."""

    key: str
    """A hash of all of it."""
    description: bytes
    """The description, pickled: workers trust who gives them work, as `dask.distributed` makes them do."""
    files: Mapping[str, tuple[str, bytes]]
    """By the name in the description: the file's name here, a hash with its extension, and its contents."""

    @classmethod
    def of(cls, description: Mapping[str, Any]) -> Bundle:
        """Pack a description.

        Raises:
            SceneError: It holds things that can't travel, such as plugins that are loaded already.
            FileError: A file can't be read.
        """
        try:
            packed = pickle.dumps(description)
        except Exception as error:  # whatever an object raises that can't be pickled
            raise SceneError(f"the scene can't travel to workers: {error}; describe it by a dict or a file") from None
        files = {}
        for name, path in named_files(description).items():
            contents = read_bytes(path)
            files[name] = (hashlib.blake2b(contents, digest_size=16).hexdigest() + path.suffix, contents)
        total = hashlib.blake2b(packed, digest_size=16)
        for name, (stored, _) in sorted(files.items()):
            total.update(f"{name}\0{stored}\0".encode())
        return cls(total.hexdigest(), packed, files)

    def unpacked(self) -> dict[str, Any]:
        """The description, naming files that are written here, in the folder for temporary files."""
        places = {}
        folder = Path(tempfile.gettempdir()) / f"djpt-cluster-{self.key}"
        for name, (stored, contents) in self.files.items():
            folder.mkdir(mode=0o700, exist_ok=True)
            place = folder / stored
            if not place.exists():
                with replacing(place) as temporary:
                    temporary.write_bytes(contents)
            places[name] = str(place)
        return with_files(pickle.loads(self.description), places)
