"""The conversion of XML elements to nodes: parameters, includes, names, old versions."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from djpt.core.limits import MAX_FILES, MAX_INCLUDES, MAX_NODES
from djpt.description.files import FileResolver, file_resolver
from djpt.description.xml import source
from djpt.description.xml.nodes import Node, Reference
from djpt.description.xml.objects import OBJECTS, check_type, check_types, is_object
from djpt.description.xml.parameters import Parameters
from djpt.description.xml.source import Element
from djpt.description.xml.upgrade import Version, is_old, parse_version, upgrade_name, upgrade_node, upgrade_tag
from djpt.description.xml.values import VALUES, check_attributes, spectrum_file
from djpt.errors import FileError, SceneError, near_miss

__all__ = ["Reader"]

_OPERATIONS = ("translate", "scale", "rotate", "lookat", "matrix")
"""The tags within a ``<transform>``."""
_OTHERS = ("transform", "ref", "include", "alias", "default", "path")


@dataclass
class _File:
    """The file that is being read."""

    name: str
    version: Version
    resolver: FileResolver
    real: tuple[str, ...]
    """Paths, without links, of this file and of those that include it, outermost first."""

    def resolve(self, name: str, element: Element) -> Path:
        """Find a file that is named in this one."""
        try:
            return self.resolver.find(name)
        except FileError as error:
            raise element.error(str(error)) from None


class Reader:
    """One call of `load_file` or `load_string`.

    Args:
        given: values of parameters.
        root: the directory that an untrusted scene may not leave, or None.
    """

    def __init__(self, given: Mapping[str, Any], root: Path | None = None) -> None:
        self.parameters = Parameters(given)
        self.ids: dict[str, Node] = {}
        """All nodes by id, and by alias."""
        self.directories: tuple[Path, ...] = ()
        """The directories in which the outermost file looks for others."""
        self.root = root
        self._files = 0
        self._objects = 0

    def read_file(self, path: Path, outer: _File | None = None) -> Node:
        """Read the root object of a file; `outer` is the file that includes it."""
        self._files += 1
        real = os.path.realpath(path)
        stack = (*outer.real, real) if outer else (real,)
        inherited = outer.resolver if outer else file_resolver()
        resolver = FileResolver((path.parent, *inherited), self.root)
        return self._read(source.parse_file(path), str(path), resolver, stack)

    def read_string(self, text: str | bytes) -> Node:
        """Read the root object of a text."""
        return self._read(source.parse(text, "<string>"), "<string>", FileResolver(file_resolver(), self.root), ())

    def _read(self, root: Element, name: str, resolver: FileResolver, stack: tuple[str, ...]) -> Node:
        if not is_object(root):
            possible = near_miss(root.tag, OBJECTS)
            raise root.error(f"a scene file begins with <scene version=...> or another object{possible}")
        text = root.attributes.pop("version", None)
        if text is None:
            raise root.error("the attribute 'version' is missing, such as version=\"3.0.0\"")
        version = parse_version(text)
        if version is None:
            raise root.error(f"the version must be three numbers such as 3.0.0, found '{text}'")
        check_types(root)
        file = _File(name, version, resolver, stack)
        self._substitute(root)
        node = self._object(root, file, None)
        if len(stack) <= 1:
            self.directories = tuple(file.resolver)
        return node

    # ---- elements --------------------------------------------------------------------------

    def _substitute(self, element: Element) -> None:
        """Replace parameters in an element's attributes."""
        for name, text in element.attributes.items():
            try:
                element.attributes[name] = self.parameters.substitute(text)
            except SceneError as error:
                raise element.error(f"'{name}': {error}") from None

    def _object(self, element: Element, file: _File, parent: Node | None) -> Node:
        """Make a node with all that is nested in it, and register it by its id."""
        if element.tag == "scene" and parent is not None:
            raise element.error("a scene can't be nested; to merge files use <include>")
        if element.tag == "scene":
            check_attributes(element, optional="type id name")
        else:
            check_attributes(element, "type", "id name")
            check_type(element)
        self._objects += 1
        if self._objects > MAX_NODES:
            raise element.error(f"more than {MAX_NODES} objects")
        kind = element.attributes.get("type", "scene")
        node = Node(element.tag, kind, element.attributes.get("id", ""), element.place)
        if node.id:
            self._register(node.id, node, element)
        for child in element.children:
            self._child(child, node, file, is_root=parent is None)
        if is_old(file.version):
            upgrade_node(node)
        return node

    def _register(self, name: str, node: Node, element: Element) -> None:
        if name in self.ids:
            raise element.error(f"the id '{name}' is already taken ({self.ids[name].place})")
        self.ids[name] = node

    def _child(self, element: Element, parent: Node, file: _File, is_root: bool) -> None:
        """Add the entry of an element to the object around it."""
        tag = element.tag
        if tag in _OPERATIONS or (is_old(file.version) and upgrade_tag(tag) in _OPERATIONS):
            raise element.error("can only stand in a <transform>")
        if not is_object(element) and tag not in VALUES and tag not in _OTHERS:
            raise element.error(f"unknown tag{near_miss(tag, [*OBJECTS, *VALUES, *_OTHERS])}")
        self._substitute(element)
        for inner in element.children if not is_object(element) and tag != "transform" else ():
            raise inner.error(f"can't stand in a <{tag}>")
        name = self._name(element, file)
        if is_object(element):
            parent.add(name, self._object(element, file, parent), element)
        elif tag == "include":
            self._include(element, name, parent, file)
        elif tag == "ref":
            check_attributes(element, "id", "name")
            parent.add(name, Reference(element.attributes["id"]), element)
        elif tag == "alias":
            self._alias(element)
        elif tag == "default":
            self._default(element)
        elif tag == "path":
            self._path(element, file, is_root)
        else:
            value = self._value(element, file)
            if not name:
                raise element.error("the name is empty")
            parent.add(name, value, element)

    @staticmethod
    def _name(element: Element, file: _File) -> str:
        """The name of an element in the object around it, in the form of the current version."""
        name = element.attributes.get("name", "")
        return upgrade_name(name) if is_old(file.version) else name

    def _value(self, element: Element, file: _File) -> Any:
        if element.tag == "transform":
            if is_old(file.version):
                for child in element.children:
                    child.tag = upgrade_tag(child.tag)
            # Here, and not above: a misspelt plugin is found out before NumPy is imported.
            from djpt.description.xml.transforms import transform

            return transform(element, self._substitute)
        if element.tag == "spectrum" and "filename" in element.attributes:
            check_attributes(element, "name filename")
            return spectrum_file(element, file.resolve(element.attributes["filename"], element))
        value = VALUES[element.tag](element)
        if element.tag == "string" and element.attributes["name"] == "filename":
            # Made absolute here, where the file's directory is known: the dict then means the same everywhere.
            return str(file.resolve(value, element).absolute())
        return value

    # ---- tags with a meaning of their own ----------------------------------------------------

    def _include(self, element: Element, name: str, parent: Node, file: _File) -> None:
        """Include a file: the contents of a scene replace the tag; any other object is nested in its place."""
        check_attributes(element, "filename", "name")
        path = file.resolve(element.attributes["filename"], element)
        real = os.path.realpath(path)
        if real in file.real:
            circle = [Path(step).name for step in (*file.real[file.real.index(real) :], real)]
            raise element.error(f"files include each other in a cycle: {' -> '.join(circle)}")
        if len(file.real) >= MAX_INCLUDES:
            raise element.error(f"includes are nested deeper than {MAX_INCLUDES} levels")
        if self._files >= MAX_FILES:
            raise element.error(f"more than {MAX_FILES} files are included")
        try:
            root = self.read_file(path, file)
        except FileError as error:
            raise element.error(str(error)) from None
        if root.tag != "scene":
            parent.add(name, root, element)
            return
        self.ids = {key: node for key, node in self.ids.items() if node is not root}
        for entry in root.entries:
            parent.append(entry)

    def _alias(self, element: Element) -> None:
        check_attributes(element, "id as")
        name = element.attributes["id"]
        if name not in self.ids:
            raise element.error(f"nothing above has the id '{name}'{near_miss(name, self.ids)}")
        self._register(element.attributes["as"], self.ids[name], element)

    def _default(self, element: Element) -> None:
        check_attributes(element, "name value")
        if not element.attributes["name"]:
            raise element.error("the name is empty")
        self.parameters.declare(element.attributes["name"], element.attributes["value"])

    def _path(self, element: Element, file: _File, is_root: bool) -> None:
        """Add a directory in which files are looked up from here on, before the others."""
        check_attributes(element, "value")
        if not is_root:
            raise element.error("can only stand directly in the file's outermost object")
        folder = file.resolve(element.attributes["value"], element)
        file.resolver = FileResolver((folder, *file.resolver), self.root)
