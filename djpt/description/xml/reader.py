"""The conversion of XML elements to nodes: parameters, includes, names, old versions."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from djpt.core.limits import MAX_FILES, MAX_INCLUDES, MAX_NODES
from djpt.description.files import FileResolver, file_resolver
from djpt.description.registry import kind_of, mitsuba_kind_of, unknown
from djpt.description.xml import source
from djpt.description.xml.source import (
    VALUES,
    Element,
    Entry,
    Node,
    Reference,
    check_attributes,
    number,
    spectrum_file,
)
from djpt.errors import FileError, SceneError, near_miss

__all__ = ["LONGEST", "OBJECTS", "Parameters", "Reader", "Version", "upgrade_name"]

Version = tuple[int, int, int]

_UV = ("uoffset", "voffset", "uscale", "vscale")


def parse_version(text: str) -> Version | None:
    """Parse a version such as ``3.0.0``; None if it isn't one. Missing parts are 0."""
    if not re.fullmatch(r"\d{1,6}(\.\d{1,6}){0,2}", text.strip(), re.ASCII):
        return None
    parts = [int(part) for part in text.split(".")]
    major, minor, patch = [*parts, 0, 0][:3]
    return major, minor, patch


def is_old(version: Version) -> bool:
    """True if files of this version use the old names."""
    return version < (2, 0, 0)


def upgrade_tag(tag: str) -> str:
    """The current name of a tag."""
    return "lookat" if tag == "lookAt" else tag


def upgrade_name(name: str) -> str:
    """The current form of a name: ``toWorld`` -> ``to_world``, ``intIOR`` -> ``int_ior``."""
    return re.sub(r"(?<=[a-z])([A-Z]+)", lambda found: "_" + found[1].lower(), name)


def upgrade_node(node: Node) -> None:
    """Rename and merge parameters, after `upgrade_name`."""
    reflectance = node.find("diffuse_reflectance")
    if node.type == "diffuse" and reflectance is not None and node.find("reflectance") is None:
        reflectance.name = "reflectance"
    found = {entry.name: entry for entry in node.entries if entry.name in _UV}
    if not found or not all(isinstance(entry.value, (int, float)) for entry in found.values()):
        return  # the loader reports what is wrong with other values
    from djpt.core.transforms import ScalarTransform4f  # here: NumPy takes long to import

    offset = [found[name].value if name in found else 0.0 for name in ("uoffset", "voffset")]
    scale = [found[name].value if name in found else 1.0 for name in ("uscale", "vscale")]
    to_uv = ScalarTransform4f.scale([*scale, 1.0]).translate([*offset, 0.0])
    place = next(iter(found.values())).place
    node.entries = [entry for entry in node.entries if entry.name not in _UV]
    node.append(Entry("to_uv", to_uv, place))


# ---- the tags that stand for plugins ---------------------------------------------------------


OBJECTS = {
    "scene": "scene",
    "bsdf": "bsdf",
    "emitter": "emitter",
    "film": "film",
    "integrator": "integrator",
    "medium": "medium",
    "phase": "phase",
    "rfilter": "rfilter",
    "sampler": "sampler",
    "sensor": "sensor",
    "shape": "shape",
    "texture": "texture",
    "volume": "volume",
}
"""The tags of objects, and the kind of plugin that each holds."""


def is_object(element: Element) -> bool:
    """True if an element stands for a plugin."""
    return element.tag in OBJECTS or (element.tag == "spectrum" and "type" in element.attributes)


def check_types(root: Element) -> None:
    """Check the plugins of an element and of all below it, before anything is converted.

    Raises `SceneError` for the first one that doesn't exist, as `check_type`. Types with parameters are left out.
    """
    elements = [root]
    while elements:
        element = elements.pop()
        if is_object(element) and "$" not in element.attributes.get("type", "$"):
            check_type(element)
        elements += reversed(element.children)


def check_type(element: Element) -> None:
    """Raise `SceneError` if neither djpt nor Mitsuba has the plugin of an element, or if its tag is another."""
    expected, name = OBJECTS.get(element.tag, "texture"), element.attributes["type"]
    kind = kind_of(name) or mitsuba_kind_of(name)
    if kind is None:
        raise element.error(str(unknown(expected, name)))
    if kind != expected:
        tag = next((tag for tag, of in OBJECTS.items() if of == kind), kind)
        raise element.error(f"'{name}' is a {kind}; write <{tag} type=...>")


# ---- the parameters ``$name``: their values, and whether they are used -----------------------


LONGEST = 1_000_000
"""Most characters of an attribute after substitution: parameters made of parameters grow exponentially."""

_NAME = re.compile(r"\w*")


class Parameters:
    r"""The parameters of one call of `load_file`, shared by all files that it reads.

    A name is replaced wherever it follows a ``$``, also in the middle of a text; among several that
    fit, the longest counts. ``\$`` is a plain dollar sign.

    Args:
        given: the caller's values: strings, numbers, booleans, or sequences of numbers.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        self._values = {name: _text(name, value) for name, value in given.items()}
        self._given = frozenset(self._values)
        self._known: set[str] = set()
        """Names that a file declares or uses."""
        self._used: set[str] = set()
        self._sort()

    def _sort(self) -> None:
        self._by_length = sorted(self._values, key=len, reverse=True)

    def declare(self, name: str, value: str) -> None:
        """Declare a ``<default>``, which counts unless there is a value already."""
        self._known.add(name)
        if name not in self._values:
            self._values[name] = value
            self._sort()

    def substitute(self, text: str) -> str:
        """`text` with all parameters replaced.

        Raises:
            SceneError: an unknown parameter, or the result is too long.
        """
        if "$" not in text:
            return text
        parts, start = [], 0
        while (at := text.find("$", start)) >= 0:
            if at > 0 and text[at - 1] == "\\":
                parts.append(text[start : at - 1] + "$")
                start = at + 1
                continue
            name = next((n for n in self._by_length if text.startswith(n, at + 1)), None)
            if name is None:
                raise self._unknown(text[at + 1 :])
            self._known.add(name)
            self._used.add(name)
            parts += [text[start:at], self._values[name]]
            start = at + 1 + len(name)
            if sum(map(len, parts)) > LONGEST:
                raise SceneError(f"longer than {LONGEST} characters after substitution")
        return "".join([*parts, text[start:]])

    def _unknown(self, rest: str) -> SceneError:
        found = _NAME.match(rest)
        name = found[0] if found else ""
        if not name:
            hint = "; write $name" if rest.startswith("{") else r"; write \$ for a dollar sign"
            return SceneError(f"'$' without the name of a parameter{hint}")
        hint = near_miss(name, self._values)
        return SceneError(
            f"unknown parameter '${name}'{hint or f'; give {name}=... or write <default> in front of its first use'}"
        )

    def check_all_used(self, where: str) -> None:
        """Raise `SceneError` for a value that was given and that no file uses; `where` names the file."""
        for name in sorted(self._given - self._used):
            hint = near_miss(name, self._known - self._given) or "; the file has no parameters"
            raise SceneError(f"{where}: the parameter '{name}' isn't used{hint}")


def _text(name: str, value: Any) -> str:
    """Convert a parameter's value to the text that a file would have."""
    if not name:
        raise SceneError("a parameter needs a name")
    if isinstance(value, str):
        return value
    # Here: only Python callers have other values, and NumPy takes long to import.
    import numpy as np

    from djpt.core.numeric import as_array, describe

    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    try:
        numbers = as_array(value)
    except SceneError:
        raise SceneError(
            f"the parameter '{name}' must be a string, a number, a boolean or several numbers, found {describe(value)}"
        ) from None
    return " ".join(repr(float(x)) for x in numbers.ravel())


# ---- the conversion --------------------------------------------------------------------------


_OPERATIONS = ("translate", "scale", "rotate", "lookat", "matrix")
"""The tags within a ``<transform>``."""
_OTHERS = ("transform", "animation", "ref", "include", "alias", "default", "path")


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
        self._animations: dict[str, Any] = {}
        """Animated transforms by their ids."""
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
        holds = ("transform", "animation")
        for inner in element.children if not is_object(element) and tag not in holds else ():
            raise inner.error(f"can't stand in a <{tag}>")
        name = self._name(element, file)
        if is_object(element):
            parent.add(name, self._object(element, file, parent), element)
        elif tag == "include":
            self._include(element, name, parent, file)
        elif tag == "animation":
            self._animation(element, name, parent, file)
        elif tag == "ref" and element.attributes.get("id") in self._animations:
            parent.add(name, self._animations[element.attributes["id"]], element)
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

    def _animation(self, element: Element, name: str, parent: Node, file: _File) -> None:
        """Add an animated transform; one with an id can be referred to further down. In a scene it is just declared."""
        from djpt.description.animation import AnimatedTransform4f

        check_attributes(element, "", "name id")
        keyframes = []
        for child in element.children:
            if child.tag != "transform":
                raise child.error(f"can't stand in an <animation>{near_miss(child.tag, ['transform'])}")
            self._substitute(child)
            if "time" not in child.attributes:
                raise child.error("a keyframe needs the attribute 'time'")
            time = number(child, child.attributes.pop("time"))
            child.attributes["name"] = name
            keyframes.append((time, self._value(child, file)))
        try:
            animation = AnimatedTransform4f(keyframes)
        except SceneError as error:
            raise element.error(str(error)) from None
        if identity := element.attributes.get("id"):
            if identity in self.ids or identity in self._animations:
                raise element.error(f"the id '{identity}' is already taken")
            self._animations[identity] = animation
        if name:
            parent.add(name, animation, element)
        elif not identity:
            raise element.error("the name is empty")

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
