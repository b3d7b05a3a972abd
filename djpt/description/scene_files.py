"""Load scene files: Mitsuba 3's XML, with parameters."""

from __future__ import annotations

import os
from typing import Any

from djpt.description.loader import load_dict
from djpt.description.xml.reading import read_file, read_string

__all__ = ["load_file", "load_string"]


def load_file(
    path: str | os.PathLike[str],
    parallel: bool = True,
    optimize: bool = True,
    *,
    trusted: bool = True,
    root: str | os.PathLike[str] | None = None,
    **parameters: Any,
) -> Any:
    """Build a scene, or any other plugin, from an XML file of Mitsuba 3.

    File names in it are looked up in its own directory first, then in the working directory.

    Args:
        path: the file.
        parallel: accepted for Mitsuba's signature, no effect.
        optimize: false for lights that are numbered in the file's order: see `djpt.load_dict`.
        trusted: false for a scene of a stranger: it may read files in `root` only, whatever names, links or
            includes it has. See SECURITY.md for what else is promised.
        root: that directory; default: the one of the file.
        parameters: values for the ``$name`` of the file: strings, numbers, booleans. They win over the
            file's ``<default>``.

    Returns:
        A `djpt.Scene` if the outermost tag is ``<scene>``, else the plugin.

    Raises:
        FileError: the file can't be read.
        SceneError: the scene is wrong, a parameter is missing or unused; the message names file and line.
    """
    return load_dict(read_file(path, trusted=trusted, root=root, **parameters), parallel, optimize)


def load_string(
    value: str | bytes,
    parallel: bool = True,
    optimize: bool = True,
    *,
    trusted: bool = True,
    root: str | os.PathLike[str] | None = None,
    **parameters: Any,
) -> Any:
    """Build a scene, or any other plugin, from the text of an XML file: see `load_file`.

    File names are looked up in the working directory, which is also the default of `root`.
    """
    return load_dict(read_string(value, trusted=trusted, root=root, **parameters), parallel, optimize)
