"""Load scene files: Mitsuba 3's XML, with parameters."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from djpt.description.document import Document
from djpt.description.files import file_resolver
from djpt.description.loader import load_dict
from djpt.description.numeric import describe
from djpt.description.xml.naming import Naming
from djpt.description.xml.nodes import Node
from djpt.description.xml.reader import Reader
from djpt.errors import FileError, SceneError
from djpt.files import require_regular

__all__ = ["load_file", "load_string", "read_file", "read_string"]


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
        optimize: accepted for Mitsuba's signature, no effect.
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


def read_file(
    path: str | os.PathLike[str],
    /,
    *,
    trusted: bool = True,
    root: str | os.PathLike[str] | None = None,
    **parameters: Any,
) -> Document:
    """Read an XML file as a dict, which can be changed and then given to `djpt.load_dict`.

    Arguments and errors are those of `load_file`. File names become absolute.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise FileError(f"the path of a scene file is a string or a path, found {describe(path)}")
    source = file_resolver().resolve(path)
    require_regular(source)
    reader = Reader(parameters, confinement(trusted, root, source.parent))
    return _document(reader, reader.read_file(source), str(source), source.stem)


def read_string(
    text: str | bytes,
    /,
    *,
    trusted: bool = True,
    root: str | os.PathLike[str] | None = None,
    **parameters: Any,
) -> Document:
    """Read the text of an XML file as a dict; arguments and errors are those of `load_string`."""
    if not isinstance(text, (str, bytes)):
        raise SceneError(f"the text of a scene file is a string, found {describe(text)}")
    reader = Reader(parameters, confinement(trusted, root, Path()))
    return _document(reader, reader.read_string(text), "<string>", "scene")


def _document(reader: Reader, root: Node, where: str, name: str) -> Document:
    reader.parameters.check_all_used(where)
    naming = Naming(reader.ids)
    return Document(naming.dict_of(root), name, naming.places, reader.directories, reader.root)


def confinement(trusted: bool, root: str | os.PathLike[str] | None, default: Path) -> Path | None:
    """The directory that a scene may not leave, without links, or None for a scene that is trusted."""
    if trusted:
        if root is not None:
            raise SceneError("'root' confines scenes that aren't trusted; set trusted=False, too")
        return None
    folder = Path(os.path.realpath(default if root is None else root))
    if not folder.is_dir():
        raise FileError(f"'root' must be a folder, found '{folder}'")
    return folder
