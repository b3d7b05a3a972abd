"""Scenes whose meshes and pixels are in memory, written to files: XML with PLY, PNG and EXR files beside it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from djpt.core.files import as_path, check_target
from djpt.description.xml.writer import write_dict as write_xml
from djpt.errors import FileError
from djpt.shapes.meshes.data import MeshData

__all__ = ["in_files", "write_dict"]

IMAGES = ("bitmap", "envmap")
"""Plugins whose pixels are written; other grids of numbers, of volumes for example, stay."""


def write_dict(path: str | os.PathLike[str], description: Mapping[str, Any]) -> None:
    """Write a description to an XML file, which `djpt.load_file` and Mitsuba read.

    Meshes and pixels in it are written to a folder beside the file, ``NAME_files``, as PLY, PNG (bytes) and EXR
    files; equal ones once. Names of files become relative to the new file if they lie in its directory, else absolute.
    The XML file appears whole or not at all.

    Raises:
        SceneError: as `djpt.to_xml`.
        FileError: a file can't be written.
    """
    target = check_target(as_path(path))
    if isinstance(description, Mapping):  # what isn't is refused below, as other wrong descriptions are
        description = in_files(description, target.parent / f"{target.stem}_files")
    write_xml(target, description)


def in_files(description: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """A copy of a description with the names of files in place of meshes and pixels, which are written to a folder.

    The folder is made if there is something to write.

    Raises:
        FileError: a file can't be written.
    """
    return Writer(folder).replaced(description)


class Writer:
    """One call of `in_files`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.names: dict[tuple[int, str], str] = {}
        """The files by what they hold."""
        self.kept: list[Any] = []
        """What has been written: two objects have different numbers while both live."""

    def replaced(self, node: Mapping[str, Any]) -> dict[str, Any]:
        """A copy of a node with the names of files in place of meshes and pixels."""
        result: dict[str, Any] = {}
        for key, value in node.items():
            if isinstance(value, Mapping):
                result[key] = self.replaced(value)
            elif key == "data" and isinstance(value, MeshData):
                result["filename"] = self._mesh(value)
            elif key in ("bitmap", "data") and node.get("type") in IMAGES and is_pixels(value):
                result["filename"] = self._image(value)
            else:
                result[key] = value
        return result

    def _place(self, value: Any, kind: str, suffix: str) -> tuple[str, bool]:
        """The file for a value, and whether it is there already."""
        key = (id(value), suffix)
        known = key in self.names
        if not known:
            try:
                self.folder.mkdir(exist_ok=True)
            except OSError as error:
                raise FileError(f"can't make the folder '{self.folder}': {error}") from None
            self.kept.append(value)
            self.names[key] = str(self.folder / f"{kind}_{len(self.names)}{suffix}")
        return self.names[key], known

    def _mesh(self, mesh: MeshData) -> str:
        from djpt.shapes.meshes.ply import write_ply

        name, known = self._place(mesh, "mesh", ".ply")
        if not known:
            write_ply(name, mesh)
        return name

    def _image(self, pixels: np.ndarray[Any, Any]) -> str:
        from djpt.images.image import write

        name, known = self._place(pixels, "image", ".png" if pixels.dtype == np.uint8 else ".exr")
        if not known:
            write(name, pixels)
        return name


def is_pixels(value: Any) -> bool:
    """True for the pixels of an image."""
    return isinstance(value, np.ndarray) and value.ndim in (2, 3)
