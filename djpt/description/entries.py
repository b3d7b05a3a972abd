"""The entries of a node as a mapping, and which of them were asked for."""

from __future__ import annotations

import copy
import enum
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, Final

import drjit as dr
import numpy as np

from djpt.core.numeric import as_vector, describe
from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import Plugin
from djpt.errors import SceneError, near_miss
from djpt.jit.types import Color3f

__all__ = ["REQUIRED", "Entries"]

REQUIRED: Final[Any] = type("Required", (), {"__repr__": lambda self: "REQUIRED"})()
"""Stands for "no default": the key is required."""


class EntryType(enum.Enum):
    """The type of an entry; the numbers are Mitsuba's."""

    Bool = 1
    Integer = 2
    Float = 3
    String = 4
    Vector = 5
    Color = 6
    Spectrum = 7
    Transform = 8
    Reference = 9
    ResolvedReference = 10
    Object = 11
    Any = 12


class Entries:
    """The entries of a node by key, in order, and the node's names.

    Args:
        plugin_name: the node's ``type``; or the entries of a node, to be copied.
        node: path for messages, such as ``scene.white``; default: `plugin_name`.
        values: the entries without ``type`` and ``id``; nested nodes are plugins already.
        id: the value of `id`; default: `node`.
    """

    Type = EntryType

    node: str
    _plugin_name: str
    _id: str
    _values: dict[str, Any]

    def __init__(
        self,
        plugin_name: str | Entries = "",
        node: str | None = None,
        values: Mapping[str, Any] | None = None,
        id: str | None = None,
    ) -> None:
        if isinstance(plugin_name, Entries):
            node, values, id = plugin_name.node, plugin_name._values, plugin_name._id
            plugin_name = plugin_name._plugin_name
        self._plugin_name = plugin_name
        self.node = plugin_name if node is None else node
        self._id = id if id is not None else node or ""
        self._values = dict(values or {})
        self._asked: set[str] = set()
        self._used: set[str] = set()

    # ---- the node ------------------------------------------------------------------------

    def plugin_name(self) -> str:
        """The node's ``type``."""
        return self._plugin_name

    def set_plugin_name(self, name: str, /) -> None:
        """Give the node another ``type``."""
        self._plugin_name = name

    def id(self) -> str:
        """The name of the plugin that is made from this node."""
        return self._id

    def set_id(self, id: str, /) -> None:
        """Give the plugin that is made from this node another name."""
        self._id = id

    # ---- entries -------------------------------------------------------------------------

    def __contains__(self, key: str) -> bool:
        self._asked.add(key)
        return key in self._values

    def __getitem__(self, key: str) -> Any:
        """The entry as in Mitsuba: numbers, strings, plugins; colours as `Color3f`."""
        return as_in_mitsuba(self._take(key, REQUIRED))

    def __setitem__(self, key: str, value: Any) -> None:
        self._values[key] = storable(key, value)
        self._used.discard(key)

    def __delitem__(self, key: str) -> None:
        if key not in self._values:
            raise KeyError(f"'{key}'{near_miss(key, self._values)}")
        del self._values[key]
        self._used.discard(key)

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._values))

    def __len__(self) -> int:
        return len(self._values)

    def get(self, key: str, def_value: Any = None) -> Any:
        """``props[key]``, or `def_value` if there is no such entry."""
        return as_in_mitsuba(self._take(key, def_value))

    def keys(self) -> list[str]:
        """All keys, in the order of the description."""
        return list(self._values)

    def items(self) -> list[tuple[str, Any]]:
        """All keys with their entries, which don't count as asked for."""
        return [(key, as_in_mitsuba(value)) for key, value in self._values.items()]

    def as_string(self, key: str) -> str:
        """The entry as text."""
        value = self[key]
        return (
            value
            if isinstance(value, str)
            else ("true" if value else "false")
            if value in (True, False)
            else str(value)
        )

    def type(self, key: str, /) -> EntryType:
        """The type of the entry."""
        if key not in self._values:
            raise SceneError(f"{self.node}: there is no entry '{key}'{near_miss(key, self._values)}")
        return type_of(self._values[key])

    def objects(self, mark_queried: bool = True) -> list[tuple[str, Plugin]]:
        """All nested plugins with their keys; they count as asked for unless `mark_queried` is false."""
        found = [(key, value) for key, value in self._values.items() if isinstance(value, Plugin)]
        if mark_queried:
            self._used.update(key for key, _ in found)
        return found

    def references(self) -> list[tuple[str, str]]:
        """References that aren't resolved yet: none, since nested nodes are plugins already."""
        return []

    def merge(self, other: Entries, /) -> None:
        """Take over all entries of another node, in place of those of the same key."""
        self._values.update(copy.copy(other._values))

    def has_property(self, key: str) -> bool:
        """``key in props``."""
        warnings.warn("has_property() is deprecated: use 'key in props'", DeprecationWarning, stacklevel=2)
        return key in self

    def remove_property(self, key: str) -> bool:
        """``del props[key]``; whether there was such an entry."""
        warnings.warn("remove_property() is deprecated: use 'del props[key]'", DeprecationWarning, stacklevel=2)
        known = key in self._values
        if known:
            del self[key]
        return known

    def property_names(self) -> list[str]:
        """``props.keys()``."""
        warnings.warn("property_names() is deprecated: use 'props.keys()'", DeprecationWarning, stacklevel=2)
        return self.keys()

    # ---- what was asked for --------------------------------------------------------------

    def mark_queried(self, key: str, value: bool = True) -> bool:
        """Note that an entry was asked for, or that it wasn't; whether there is such an entry."""
        if key in self._values:
            (self._used.add if value else self._used.discard)(key)
        return key in self._values

    def was_queried(self, key: str, /) -> bool:
        """True if an entry was asked for."""
        if key not in self._values:
            raise SceneError(f"{self.node}: there is no entry '{key}'{near_miss(key, self._values)}")
        return key in self._used

    def unqueried(self) -> list[str]:
        """The keys of the entries that weren't asked for."""
        return [key for key in self._values if key not in self._used]

    def _take(self, key: str, default: Any) -> Any:
        """Take the raw entry, or `default`, and mark its key as used."""
        self._asked.add(key)
        if key in self._values:
            self._used.add(key)
            return self._values[key]
        if default is REQUIRED:
            left = [k for k in self._values if k not in self._used]
            hint = near_miss(key, left, label="found")
            raise SceneError(f"{self.node}: '{self._plugin_name}' needs the key '{key}'{hint}")
        return default

    # ---- the whole -----------------------------------------------------------------------

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Entries):
            return NotImplemented
        mine, theirs = (self._plugin_name, self._id), (other._plugin_name, other._id)
        return (
            mine == theirs
            and self._values.keys() == other._values.keys()
            and all(same(value, other._values[key]) for key, value in self._values.items())
        )

    __hash__ = None  # type: ignore[assignment]  # it can be edited

    def __repr__(self) -> str:
        lines = [f'    "{key}" -> {text_of(value)}' for key, value in self._values.items()]
        body = ",\n".join(lines) + ("\n" if lines else "")
        names = [f'  plugin_name = "{self._plugin_name}",', f'  id = "{self._id}",']
        return "\n".join(["Properties[", *names, "  elements = {", f"{body}  }}", "]", ""])


def as_in_mitsuba(value: Any) -> Any:
    """Convert an entry for scripts: constant colours and number triples to `Color3f`, NumPy's scalars to Python's."""
    if isinstance(value, Plugin):
        return value.as_property()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (list, tuple, np.ndarray)) and np.shape(value) == (3,):
        return Color3f(*as_vector(value).tolist())
    return value


def storable(key: str, value: Any) -> Any:
    """Check a value that a script stores; NumPy's scalars become Python's."""
    if isinstance(value, np.generic):
        if value.dtype.kind not in "biuf":
            raise SceneError(f"'{key}' can't hold numbers of the type {value.dtype}")
        return value.item()
    if value is None or isinstance(value, Mapping):
        raise SceneError(
            f"'{key}' can't hold {describe(value)}; possible: numbers, strings, vectors, transforms, plugins, arrays"
        )
    return value


def type_of(value: Any) -> EntryType:
    """The type of a value in Mitsuba's terms."""
    kinds: list[tuple[Any, EntryType]] = [
        ((bool, np.bool_), EntryType.Bool),
        ((int, np.integer), EntryType.Integer),
        ((float, np.floating), EntryType.Float),
        (str, EntryType.String),
        (Plugin, EntryType.Object),
        (ScalarTransform4f, EntryType.Transform),
    ]
    found = next((kind for types, kind in kinds if isinstance(value, types)), None)
    if found is not None:
        return found
    if dr.is_array_v(value) and dr.is_jit_v(value) and not dr.is_tensor_v(value) and dr.size_v(value) == 3:
        return EntryType.Color
    is_vector = np.shape(value) == (3,) if isinstance(value, (list, tuple, np.ndarray)) else dr.size_v(value) == 3
    return EntryType.Vector if is_vector else EntryType.Any


def same(a: Any, b: Any) -> bool:
    """True if two entries are equal, type and all."""
    if type(a) is not type(b):
        return False
    if dr.is_array_v(a) or isinstance(a, np.ndarray):
        return np.array_equal(np.array(a), np.array(b))
    return bool(a is b or a == b)


def text_of(value: Any) -> str:
    """An entry in Mitsuba's notation."""
    if isinstance(value, str):
        return f'"{value}"'
    return str(value).lower() if isinstance(value, bool) else str(value)
