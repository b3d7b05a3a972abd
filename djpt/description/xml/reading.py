"""Scene files read as dicts.

Neither Dr.Jit nor NumPy is imported before the plugins of a file are known to exist: a misspelt name is found out at
once.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from djpt.core.files import as_path, require_regular
from djpt.description.document import Document
from djpt.description.files import file_resolver
from djpt.description.xml.naming import Naming
from djpt.description.xml.nodes import Node
from djpt.description.xml.reader import Reader
from djpt.errors import FileError, SceneError

__all__ = ["read_file", "read_string"]


def read_file(
    path: str | os.PathLike[str],
    /,
    *,
    trusted: bool = True,
    root: str | os.PathLike[str] | None = None,
    **parameters: Any,
) -> Document:
    """Read an XML file as a dict, which can be changed and then given to `djpt.load_dict`.

    Arguments and errors are those of `djpt.load_file`. File names become absolute.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise FileError(f"the path of a scene file is a string or a path, found {_describe(path)}")
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
    """Read the text of an XML file as a dict; arguments and errors are those of `djpt.load_string`."""
    if not isinstance(text, (str, bytes)):
        raise SceneError(f"the text of a scene file is a string, found {_describe(text)}")
    reader = Reader(parameters, confinement(trusted, root, Path()))
    return _document(reader, reader.read_string(text), "<string>", "scene")


def _describe(value: object) -> str:
    """Describe a value that isn't a file."""
    from djpt.core.numeric import describe

    return describe(value)


def _document(reader: Reader, root: Node, where: str, name: str) -> Document:
    reader.parameters.check_all_used(where)
    naming = Naming(reader.ids)
    return Document(naming.dict_of(root), name, naming.places, reader.directories, reader.root)


def confinement(trusted: bool, root: str | os.PathLike[str] | None, default: Path) -> Path | None:
    """The directory that a scene may not leave, without links, or None for a scene that is trusted."""
    if not isinstance(trusted, bool):
        raise SceneError(f"'trusted' must be True or False, found {_describe(trusted)}")
    if trusted:
        if root is not None:
            raise SceneError("'root' confines scenes that aren't trusted; set trusted=False, too")
        return None
    folder = Path(os.path.realpath(default if root is None else as_path(root)))
    if not folder.is_dir():
        raise FileError(f"'root' must be a folder, found '{folder}'")
    return folder
