"""The writer of scene files, from dicts."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import drjit as dr
import numpy as np

from djpt.core.files import as_path, check_target, writing
from djpt.core.numeric import as_array, as_number, describe
from djpt.core.transforms import ScalarTransform3f, ScalarTransform4f, matrix_of
from djpt.description.loader import Loader
from djpt.description.plugin import Plugin
from djpt.description.registry import kind_of, mitsuba_kind_of, unknown
from djpt.description.xml.reader import OBJECTS
from djpt.errors import SceneError

__all__ = ["to_xml", "write_dict"]

VERSION = "3.0.0"
"""The version of Mitsuba that files are written for."""

_INDENT = "    "
_TAGS = {kind: tag for tag, kind in OBJECTS.items()}
_UNWRITABLE = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that no XML file can hold."""


def to_xml(description: Mapping[str, Any]) -> str:
    """Convert a description to the text of an XML file.

    Loading it gives the same scene: numbers keep all digits. Keys at the top become ids.

    Raises:
        SceneError: the description is wrong, or holds values that a file can't: plugin objects, functions, pixels.
    """
    return _Writer(description, None).text()


def write_dict(path: str | os.PathLike[str], description: Mapping[str, Any]) -> None:
    """Write a description to an XML file, which `djpt.load_file` and Mitsuba read.

    Names of files become relative to the new file if they lie in its directory, else absolute. The file appears
    whole or not at all.

    Raises:
        SceneError: as `to_xml`.
        FileError: the file can't be written.
    """
    target = as_path(path)
    text = _Writer(description, check_target(target).parent).text()
    with writing(target) as temporary:
        temporary.write_text(text, "utf-8")


class _Writer:
    """One call of `to_xml`."""

    def __init__(self, description: Mapping[str, Any], folder: Path | None) -> None:
        self.loader = Loader(description)
        self.loader.collect()
        self.folder = folder
        self.lines: list[str] = []
        self.in_scene = self.loader.root["type"] == "scene"
        self.ids = self._ids()

    def text(self) -> str:
        self._node("", "", self.loader.root, 0)
        return "\n".join([*self.lines, ""])

    def _ids(self) -> dict[str, str]:
        """The ids of nodes, by path: their own, their key at the top of a scene, or one made for references."""
        ids: dict[str, str] = {}
        for path, node in self.loader.nodes.items():
            if not isinstance(node, Mapping) or node["type"] == "ref":
                continue
            if "id" in node:
                ids[path] = node["id"]
            elif self.in_scene and path and "." not in path:
                ids[path] = path
        for path, node in self.loader.nodes.items():
            if not isinstance(node, Mapping) or node["type"] != "ref":
                continue
            target = self._target(path)
            if target not in ids:
                free = target.replace(".", "_")
                while free in self.loader.paths or free in ids.values():
                    free += "_"
                ids[target] = free
        return ids

    def _target(self, path: str) -> str:
        """The path of the node that a reference, or a chain of them, leads to."""
        seen = [path]
        while True:
            node = self.loader.nodes[seen[-1]]
            if not isinstance(node, Mapping) or node["type"] != "ref":
                return seen[-1]
            following = self.loader.target(node, seen[-1])
            if following in seen:
                raise SceneError(f"{self.loader.name(path)}: references form a cycle")
            seen.append(following)

    # ---- tags ------------------------------------------------------------------------------

    def _tag(self, depth: int, tag: str, end: str = "/>", **attributes: str | None) -> None:
        pairs = "".join(f" {name}={quoteattr(value)}" for name, value in attributes.items() if value is not None)
        self.lines.append(f"{_INDENT * depth}<{tag}{pairs}{end}")

    def _node(self, path: str, key: str, node: Mapping[str, Any], depth: int) -> None:
        where = self.loader.name(path)
        kind = kind_of(node["type"]) or mitsuba_kind_of(node["type"])
        if kind is None:
            raise SceneError(f"{where}: {unknown(None, node['type'])}")
        at_top = self.in_scene and path == key
        attributes: dict[str, str | None] = {
            "version": None if path else VERSION,
            "type": None if node["type"] == "scene" else node["type"],
            "id": self._text(self.ids[path], where) if path in self.ids else None,
            "name": None if at_top else self._text(key, where),
        }
        entries = [(key, value) for key, value in node.items() if key not in ("type", "id")]
        if not entries:
            self._tag(depth, _TAGS[kind], "/>", **attributes)
            return
        self._tag(depth, _TAGS[kind], ">", **attributes)
        for key, value in entries:
            self._entry(f"{path}.{key}" if path else key, key, value, depth + 1)
        self.lines.append(f"{_INDENT * depth}</{_TAGS[kind]}>")

    def _entry(self, path: str, key: str, value: Any, depth: int) -> None:
        where = self.loader.name(path)
        name = self._text(key, where)
        if isinstance(value, Plugin) and value.kind == "animation":
            self._animation(name, value, depth)
            return
        if isinstance(value, Plugin):
            raise SceneError(f"{where}: is a {type(value).__name__} object; only descriptions can be written to a file")
        if isinstance(value, Mapping):
            if value["type"] == "ref":
                self._tag(depth, "ref", id=self._text(self.ids[self._target(path)], where), name=name)
            elif path in self.ids or not self._colour(name, value, depth):
                self._node(path, key, value, depth)
            return
        try:
            self._value(name, value, depth, where)
        except SceneError as error:
            message = str(error)
            raise error if message.startswith(where) else SceneError(f"{where}: {message}") from None

    def _colour(self, name: str, node: Mapping[str, Any], depth: int) -> bool:
        """Write a colour or a spectrum as the tag of that name; false if it is more than a value."""
        if node["type"] not in ("rgb", "spectrum") or set(node) != {"type", "value"}:
            return False
        try:
            array = as_array(node["value"])
        except SceneError:
            return False
        if array.ndim == 2 and array.shape[1] == 2 and node["type"] == "spectrum":
            text = ", ".join(f"{wavelength!r}:{value!r}" for wavelength, value in array.tolist())
        elif array.shape in ((), (3,)):
            text = _join(array)
        else:
            return False
        self._tag(depth, node["type"], name=name, value=text)
        return True

    def _value(self, name: str, value: Any, depth: int, where: str) -> None:
        if isinstance(value, str):
            self._tag(depth, "string", name=name, value=self._text(self._file_name(name, value), where))
        elif isinstance(value, (bool, np.bool_)):
            self._tag(depth, "boolean", name=name, value="true" if value else "false")
        elif isinstance(value, (int, np.integer)):
            self._tag(depth, "integer", name=name, value=str(int(value)))
        elif isinstance(value, (float, np.floating)):
            self._tag(depth, "float", name=name, value=repr(as_number(value)))
        else:
            self._array(name, value, depth)

    def _array(self, name: str, value: Any, depth: int) -> None:
        try:
            array = as_array(matrix_of(value))
        except SceneError as error:
            raise SceneError(f"a scene file can't hold this; it {error}") from None
        if array.shape == (4, 4):
            self._transform(name, ScalarTransform4f(array), depth)
        elif array.shape == (3, 3) and matrix_of(value) is not value:
            self._transform(name, ScalarTransform3f(array).expand(), depth)
        elif array.shape == ():
            whole = dr.is_integral_v(value) if dr.is_array_v(value) else np.asarray(value).dtype.kind in "iu"
            text = str(int(array)) if whole else _join(array)
            self._tag(depth, "integer" if whole else "float", name=name, value=text)
        elif array.shape == (3,):
            x, y, z = (_join(component) for component in array)
            self._tag(depth, "vector", name=name, x=x, y=y, z=z)
        else:
            raise SceneError(f"a scene file can't hold this array of shape {array.shape}: {describe(value)}")

    def _animation(self, name: str, animation: Any, depth: int) -> None:
        """Write the keyframes of an animated transform."""
        self._tag(depth, "animation", ">", name=name)
        for time in animation.keyframes.times.tolist():
            self._tag(depth + 1, "transform", ">", time=repr(time))
            self._tag(depth + 2, "matrix", value=_join(animation.eval_scalar(time).matrix))
            self.lines.append(f"{_INDENT * (depth + 1)}</transform>")
        self.lines.append(f"{_INDENT * depth}</animation>")

    def _transform(self, name: str, transform: ScalarTransform4f, depth: int) -> None:
        """Write a transform as scaling and translation where that is exact, else as a matrix."""
        matrix = transform.matrix
        scale, offset = np.diag(matrix)[:3], matrix[:3, 3]
        if not np.array_equal(matrix[:3, :3], np.diag(scale)):
            self._tag(depth, "transform", ">", name=name)
            self._tag(depth + 1, "matrix", value=_join(matrix))
        elif np.array_equal(matrix, np.eye(4)):
            self._tag(depth, "transform", name=name)
            return
        else:
            self._tag(depth, "transform", ">", name=name)
            if (scale != 1).any():
                self._tag(depth + 1, "scale", value=_join(scale))
            if offset.any():
                self._tag(depth + 1, "translate", value=_join(offset))
        self.lines.append(f"{_INDENT * depth}</transform>")

    # ---- texts -----------------------------------------------------------------------------

    @staticmethod
    def _text(text: str, where: str) -> str:
        r"""Escape a text for an attribute: a dollar sign is ``\$``."""
        if found := _UNWRITABLE.search(text):
            raise SceneError(f"{where}: an XML file can't hold the character {found[0]!r} of {describe(text)}")
        return text.replace("$", r"\$")

    def _file_name(self, key: str, name: str) -> str:
        """The name of a file relative to the new file's directory, if it lies there, else absolute."""
        if key != "filename" or self.folder is None:
            return name
        real = Path(os.path.abspath(name))
        if not real.exists():
            return name
        return real.relative_to(self.folder).as_posix() if real.is_relative_to(self.folder) else str(real)


def _join(numbers: Any) -> str:
    """Join numbers with all of their digits."""
    return " ".join(repr(float(x)) for x in np.ravel(numbers))
