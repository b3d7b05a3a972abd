"""Scene files read as dicts.

Neither Dr.Jit nor NumPy is imported before the plugins of a file are known to exist: a misspelt name is found out at
once.
"""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

from djpt.core.files import as_path, require_regular
from djpt.description.files import Document, file_resolver
from djpt.description.xml.reader import Reader
from djpt.description.xml.source import Entry, Node, Reference
from djpt.errors import FileError, SceneError, near_miss

__all__ = ["read_file", "read_string"]


class Naming:
    """The keys of all nodes of a file.

    The key of a node in a scene is its id, elsewhere its name in the object around it (``reflectance``); without
    one it is the tag: ``shape``, ``shape_1``. An id with dots, as exporters write them, can't be a key and
    becomes the ``id`` entry of the node.

    Args:
        ids: all nodes by id, and by alias.
    """

    def __init__(self, ids: dict[str, Node]) -> None:
        self.ids = ids
        self.places: dict[str, str] = {}
        """File and line of each node and entry, by path."""

    def dict_of(self, node: Node, path: str = "") -> dict[str, Any]:
        """Convert a node, with all that is nested in it, to a dict. Raises `SceneError`."""
        self.places[path] = node.place
        result: dict[str, Any] = {"type": node.type}
        keys = self._keys(node, at_top=not path)
        if node.id and node.id != path:
            result["id"] = node.id
        for key, entry in zip(keys, node.entries, strict=True):
            below = f"{path}.{key}" if path else key
            self.places[below] = entry.place
            value = entry.value
            if isinstance(value, Node):
                value = self.dict_of(value, below)
            elif isinstance(value, Reference):
                value = {"type": "ref", "id": self._target(value, entry).id}
            result[key] = value
        return result

    def _target(self, reference: Reference, entry: Entry) -> Node:
        """The node that a reference refers to, directly or by an alias."""
        if reference.id not in self.ids:
            hint = near_miss(reference.id, self.ids) or "; no object has an id"
            raise SceneError(f"{entry.place}: <ref>: nothing has the id '{reference.id}'{hint}")
        return self.ids[reference.id]

    def _keys(self, node: Node, at_top: bool) -> list[str]:
        """One key for each entry, in order."""
        keys = [self._own_key(entry, node.tag == "scene") for entry in node.entries]
        # At the top of a scene, keys and ids share one space of names.
        used = {"type", "id", *keys, *(self.ids if at_top else ())}
        counts: dict[str, int] = {}
        for i, entry in enumerate(node.entries):
            if not keys[i]:
                keys[i] = _unused(self._default_key(entry, node.tag == "scene"), used, counts)
                used.add(keys[i])
        return keys

    def _own_key(self, entry: Entry, in_scene: bool) -> str:
        """The key that the file gives an entry, or an empty string."""
        if not in_scene:
            return entry.name
        if isinstance(entry.value, Node) and entry.value.id:
            return "" if "." in entry.value.id else entry.value.id
        return "" if entry.name in self.ids else entry.name

    def _default_key(self, entry: Entry, in_scene: bool) -> str:
        if isinstance(entry.value, Reference):
            return self._target(entry.value, entry).tag
        if not isinstance(entry.value, Node):
            return entry.name
        return entry.value.id.replace(".", "_") if in_scene and entry.value.id else entry.value.tag


def _unused(key: str, used: Collection[str], counts: dict[str, int]) -> str:
    """`key`, or the first of ``key_1``, ``key_2``, ... that is free; `counts` has the number reached so far."""
    found = key
    while found in used:
        counts[key] = counts.get(key, 0) + 1
        found = f"{key}_{counts[key]}"
    return found


# ---- scene files read as dicts ---------------------------------------------------------------


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
