"""The conversion of a dict, or of a scene file, to plugins: names, nested nodes, references."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from typing import Any

from djpt.core.garbage import without_garbage
from djpt.core.limits import MAX_DEPTH, MAX_NAME, MAX_NODES, MAX_PARTS
from djpt.core.numeric import describe
from djpt.description.files import Document, FileResolver, file_resolver, reading_once
from djpt.description.plugin import Plugin
from djpt.description.properties import Merging, Properties
from djpt.description.registry import kind_of, lookup
from djpt.errors import SceneError, near_miss
from djpt.jit.frozen import hold_garbage

__all__ = ["Loader", "load_dict", "load_file", "load_string"]

NESTED: dict[str, tuple[str, ...]] = {
    "scene": (
        *("sensor", "integrator", "bsdf", "texture", "emitter", "shape", "sampler", "film", "rfilter"),
        *("medium", "phase", "volume"),
    ),
    "shape": ("bsdf", "emitter", "sensor", "medium", "texture", "shape"),
    "sensor": ("film", "sampler", "medium", "texture", "sensor", "shape"),
    "film": ("rfilter",),
    "bsdf": ("texture", "bsdf"),
    "emitter": ("texture", "medium"),
    "medium": ("volume", "phase", "texture"),
    "phase": ("volume", "phase", "texture"),
    "volume": ("texture", "volume"),
    "texture": ("texture", "volume"),
    "integrator": ("integrator",),
}
"""The kinds that a plugin of each kind holds."""

PLACES = {"interior": "medium", "exterior": "medium", "target": "shape"}
"""The kinds of nodes whose keys mean one kind; so do keys that are named after a kind, such as ``integrator``."""


def fitting_kinds(parent: Mapping[str, Any] | None, key: str) -> tuple[str, ...] | None:
    """The kinds of plugins that fit under a key of a node; None if any may."""
    held = NESTED.get(kind_of(str(parent.get("type"))) or "") if parent is not None else None
    meant = PLACES.get(key, key)
    return (meant,) if held is not None and meant in held else held


# ---- the conversion --------------------------------------------------------------------------


def load_dict(dict: Mapping[str, Any], parallel: bool = True, optimize: bool = True) -> Any:
    """Build a scene, or any other plugin, from Mitsuba's dict description.

    ``dict['type']`` names the plugin; nested dicts are nested plugins, ``{'type': 'ref', 'id':
    'white'}`` refers to a node by its key, by its ``id`` entry, or by its path (``floor.bsdf``),
    wherever it stands. Values may be plugins that exist already. `dict` isn't modified.

    Args:
        dict: the description, for example `djpt.cornell_box()`.
        parallel: accepted for Mitsuba's signature, no effect.
        optimize: number lights and sensors as Mitsuba's loader does, which merges meshes if it is told to optimise:
            those of rectangles, cubes and other meshes come last. So the same random number chooses the same light.
            False: the order of the description. Shapes themselves are never merged, and names are always kept.

    Returns:
        A `djpt.Scene` if the type is ``scene``, else the plugin of that type; if several stand in its place, as for
        ``merge``, a list of them.

    Raises:
        SceneError: the description is wrong; the message names the node.
    """
    if isinstance(dict, Document) and (dict.directories or dict.root is not None):
        with FileResolver((*dict.directories, *file_resolver()), dict.root).active():
            return Loader(dict, optimize).load()
    return Loader(dict, optimize).load()


class Loader:
    """One call of `load_dict`: the nodes by path, and the plugins built so far."""

    def __init__(self, root: Any, optimize: bool = True) -> None:
        self.root = root
        self.optimize = optimize
        self.places = root.places if isinstance(root, Document) else {}
        """File and line of each path, if the description comes from a file."""
        self.nodes: dict[str, Mapping[str, Any] | Plugin] = {}
        self.paths: dict[str, str] = {}
        """The path of a node by each name that a reference can use: its path or its ``id`` entry."""
        self.plugins: dict[str, Plugin] = {}
        self.parts: dict[int, int] = {}
        """The number of plugins in one, itself included, by its `id()`; one counts wherever it is referred to."""
        self.merging = Merging()
        """The plugins that are described alike."""
        self.files: Counter[str] = Counter()
        """The number of nodes that name each file."""
        self.open: list[str] = []
        """Paths of the nodes under construction, outermost first; a reference to one of them is a cycle."""

    def load(self) -> Plugin | list[Plugin]:
        """Build the root, and with it all other nodes."""
        hold_garbage()
        with without_garbage():
            self.collect()
            with reading_once({name for name, count in self.files.items() if count > 1}):
                root = self._build("")
            parts = root.expand()
        for part in parts:
            part.stand_alone()
        return parts[0] if len(parts) == 1 else parts

    def collect(self) -> None:
        """Check the form of the description, and fill `nodes` and `paths`."""
        if not isinstance(self.root, Mapping):
            raise SceneError(f"load_dict: a scene description is a dict, found {describe(self.root)}")
        self.label = self.root["type"] if isinstance(self.root.get("type"), str) else "scene"
        if node_count(self.root, {}, 0) > MAX_NODES:
            raise SceneError(f"{self.name('')}: more than {MAX_NODES} nodes; a node counts wherever it stands")
        self._collect(self.root, "", ())

    # ---- first walk: names ---------------------------------------------------------------

    def name(self, path: str, key: str = "") -> str:
        """The name of a path in messages: ``scene.white``, ``box.xml:12: scene.white``.

        With a `key`, the line is the line of this entry.
        """
        name = f"{self.label}.{path}" if path else self.label
        place = self.places.get((f"{path}.{key}" if path else key) if key else path)
        return f"{place}: {name}" if place else name

    def _collect(self, node: Mapping[str, Any], path: str, parents: tuple[int, ...]) -> None:
        """Check the form of a node and of all below it; note the names that references can use."""
        where = self.name(path)
        if id(node) in parents:
            raise SceneError(f"{where}: the dict contains itself")
        if len(parents) >= MAX_DEPTH:
            raise SceneError(f"{where}: nested deeper than {MAX_DEPTH} levels")
        self.nodes[path] = node
        self._name_node(path, path)
        for key in node:
            if not isinstance(key, str) or not key:
                raise SceneError(f"{where}: keys must be strings, found {describe(key)}")
            if len(key) > MAX_NAME:
                raise SceneError(f"{where}: keys have up to {MAX_NAME} characters, found {len(key)}: {describe(key)}")
            if "." in key:
                raise SceneError(f"{where}: the key '{key}' contains a '.', which separates the parts of a path")
        kind = node.get("type")
        if kind is None:
            raise SceneError(f"{where}: the key 'type' is missing (found: {', '.join(sorted(node)) or 'nothing'})")
        if not isinstance(kind, str):
            raise SceneError(f"{where}: 'type' must be a string, found {describe(kind)}")
        if kind == "ref":
            return
        if isinstance(file := node.get("filename"), str):
            self.files[file] += 1
        identity = node.get("id")
        if identity is not None:
            # Exporters write ids with dots, such as "Material.001": any non-empty string is a name.
            if not isinstance(identity, str) or not identity or len(identity) > MAX_NAME:
                raise SceneError(f"{where}: 'id' must be a name, found {describe(identity)}")
            self._name_node(identity, path)
        for key, value in node.items():
            below = f"{path}.{key}" if path else key
            if is_node(value):
                self._collect(value, below, (*parents, id(node)))
            elif isinstance(value, Plugin):
                self.nodes[below] = value
                self._name_node(below, below)

    def _name_node(self, name: str, path: str) -> None:
        if self.paths.setdefault(name, path) != path:
            other = self.name(self.paths[name])
            raise SceneError(f"{self.name(path)}: the name '{name}' is already taken by {other}")

    # ---- second walk: plugins ------------------------------------------------------------

    def _build(self, path: str) -> Plugin:
        """The plugin of a node; built at the first call."""
        if path in self.plugins:
            return self.plugins[path]
        node = self.nodes[path]
        if isinstance(node, Plugin):
            self.plugins[path] = node
            return node
        if path in self.open:
            circle = [*self.open[self.open.index(path) :], path]
            raise SceneError(f"{self.name(path)}: references form a cycle: {' -> '.join(circle)}")
        if len(self.open) >= MAX_DEPTH:
            raise SceneError(f"{self.name(path)}: nested deeper than {MAX_DEPTH} levels")
        self.open.append(path)
        try:
            plugin = self._build(self.target(node, path)) if node["type"] == "ref" else self._construct(node, path)
        finally:
            self.open.pop()
        self.plugins[path] = plugin
        return plugin

    def target(self, node: Mapping[str, Any], path: str) -> str:
        """The path of the node that a reference refers to."""
        where = self.name(path)
        extra = [key for key in node if key not in ("type", "id")]
        if extra:
            raise SceneError(f"{where}: unknown key '{extra[0]}' of a reference{near_miss(extra[0], ['id'])}")
        target = node.get("id")
        if not isinstance(target, str):
            raise SceneError(f"{where}: a reference needs an 'id' that is a string, found {describe(target)}")
        if target not in self.paths or target == "":
            # Suggest top-level names and ids; paths only if the reference looks like a path.
            names = (n for n in self.paths if n and ("." in target or "." not in n))
            possible = [n for n in names if self._can_be_meant(self.paths[n], path)]
            raise SceneError(f"{where}: nothing has the id '{target}'{near_miss(target, possible)}")
        return self.paths[target]

    def _can_be_meant(self, target: str, path: str) -> bool:
        """True if a reference at `path` could stand for a node: of a fitting kind, and not around the reference."""
        node, fitting = self.nodes[target], self._fitting(path)
        if isinstance(node, Mapping) and node["type"] == "ref":
            return False
        kind = kind_of(node["type"]) if isinstance(node, Mapping) else node.kind
        return (fitting is None or kind in fitting) and not f"{path}.".startswith(f"{target}.")

    def _fitting(self, path: str) -> tuple[str, ...] | None:
        """The kinds of plugins that fit at a path; None if any may."""
        above, _, key = path.rpartition(".")
        parent = self.nodes.get(above) if path else None
        return fitting_kinds(parent if isinstance(parent, Mapping) else None, key)

    def _construct(self, node: Mapping[str, Any], path: str) -> Plugin:
        name, where = node["type"], self.name(path)
        if name == "scene" and path:
            raise SceneError(f"{where}: a scene can't be nested")
        try:
            factory = lookup(None, name, self._fitting(path))
        except SceneError as error:
            raise SceneError(f"{where}: {error}") from None
        values: dict[str, Any] = {}
        nested: list[Plugin] = []
        described: set[str] = set()  # the keys of what didn't exist before
        expanded: dict[str, Plugin] = {}
        for key, value in node.items():
            if key in ("type", "id"):
                continue
            if (is_description := is_node(value)) or isinstance(value, Plugin):
                below = f"{path}.{key}" if path else key
                value = self._build(below)
                nested.append(value)
                # In a scene an explicit `id` is the name; elsewhere the key tells what the node is used for.
                key = self._own_name(below) if name == "scene" else key
                parts = value.expand()
                named = {key: value}
                if parts != [value]:
                    taken = {*node, *values, *expanded} - {key}
                    named = {f"{key}.{i}" if part.id() in taken else part.id(): part for i, part in enumerate(parts)}
                # Several parts come last, as in Mitsuba.
                (expanded if len(named) > 1 else values).update(named)
                if is_description:
                    described |= named.keys()
                continue
            values[key] = value
        values |= expanded

        count = self._count_parts(name, where, nested)

        def place(key: str) -> str:
            return self.name(path, key) if self.places and key in node else where

        merging = self.merging.of(described) if self.optimize else None
        props = Properties(name, where, values, self._own_name(path) or name, place, merging)
        try:
            plugin: Any = factory(props)
        except SceneError as error:
            raise props.placed(error) from None
        if not isinstance(plugin, Plugin):
            raise SceneError(f"{where}: the factory of '{name}' returned {describe(plugin)}, not a djpt.Plugin")
        props.check_all_used()
        self.parts[id(plugin)] = count
        self.merging.note(plugin, name, values)
        return plugin

    def _count_parts(self, name: str, where: str, nested: list[Plugin]) -> int:
        """The number of plugins in one of the type `name`; raises `SceneError` if they are too many.

        References are built once, but what they refer to is used wherever they stand: levels of two references each
        would grow exponentially.
        """
        is_shape = kind_of(name) in ("shape", "scene")
        counted = [plugin for plugin in nested if not is_shape or plugin.kind == "shape"]
        parts = 1 + sum(self.parts.get(id(plugin), 1) for plugin in counted)
        most = MAX_NODES if is_shape else MAX_PARTS
        if parts > most:
            raise SceneError(f"{where}: more than {most} plugins in one; each counts wherever it is referred to")
        return parts

    def _own_name(self, path: str) -> str:
        """The name of a node: its ``id`` entry if it has one, else its path."""
        node = self.nodes[path]
        if isinstance(node, Mapping) and node["type"] != "ref":
            identity: str = node.get("id", path)
            return identity
        return path


def is_node(value: Any) -> bool:
    """True for a description of a plugin. To ask texts and numbers whether they are mappings would be slow."""
    return isinstance(value, dict) or (not isinstance(value, (str, float, int, list)) and isinstance(value, Mapping))


def node_count(node: Mapping[str, Any], known: dict[int, int], depth: int) -> int:
    """The number of nodes of a description, each counted wherever it stands; `known` has those counted before.

    What is nested too deep, such as a dict in itself, counts as one node.
    """
    if depth > MAX_DEPTH:
        return 1
    if id(node) not in known:
        nested = (value for value in node.values() if is_node(value))
        known[id(node)] = 1  # if the node contains itself
        known[id(node)] = 1 + sum(node_count(value, known, depth + 1) for value in nested)
    return known[id(node)]


# ---- Mitsuba's XML ---------------------------------------------------------------------------


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
    from djpt.description.xml.reading import read_file  # dicts need no parser

    with without_garbage():
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
    from djpt.description.xml.reading import read_string  # dicts need no parser

    with without_garbage():
        return load_dict(read_string(value, trusted=trusted, root=root, **parameters), parallel, optimize)
