"""What kernels read of a plugin whose class doesn't declare it: scripts written for Mitsuba.

Such a class keeps what it likes in its attributes, and may report some of them in `traverse`. So
all attributes count: Dr.Jit arrays of width 1 are values, plugins are children, and whatever else there
is sets instances apart, so that only those are traced as one that agree in it.
"""

from __future__ import annotations

import enum
import functools
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr

import djpt.description.plugin as plugins  # which imports this module: its names aren't there yet
from djpt.errors import ParameterError

if TYPE_CHECKING:
    from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback

__all__ = ["Inferred", "Report", "Sorts", "reporting", "sorts_of"]

PLAIN = (bool, int, float, str, bytes, type(None), enum.Enum)


class Inferred:
    """Stands for a class attribute that isn't declared: empty, or inferred from each instance."""

    def __init__(self, sort: str, empty: Any) -> None:
        self.sort, self.empty = sort, empty

    def __get__(self, plugin: Plugin | None, owner: type) -> Any:
        if plugin is None or not plugin.infers:
            return self.empty
        return getattr(sorts_of(plugin), self.sort)


@dataclass
class Sorts:
    """The attributes of a plugin by what they are to kernels."""

    values: Mapping[str, ParamFlags]
    children: Sequence[str]
    identity: Hashable
    """Differs between plugins that can't be traced as one."""
    statics: Sequence[str] = ("_identity",)


def sorts_of(plugin: Plugin) -> Sorts:
    """Look through a plugin's attributes."""
    reported, unreported = Collection(), plugins.ParamFlags.Differentiable
    if type(plugin).traverse is not plugins.Plugin.traverse:
        plugin.traverse(reported)
        unreported = plugins.ParamFlags.NonDifferentiable
    values: dict[str, ParamFlags] = {}
    children: list[str] = []
    others: list[Hashable] = []
    for name, value in vars(plugin).items():
        if isinstance(value, list):
            value = tuple(value)
        if name == "id":
            continue
        if isinstance(value, plugins.Plugin):
            children.append(name)
        elif is_uniform(value):
            values[name] = reported.flags.get(name, unreported)
        else:
            others.append((name, type(value), value) if is_plain(value) else (name, id(plugin)))
    return Sorts(values, children, (tuple(values), tuple(children), tuple(others)))


def is_uniform(value: Any) -> bool:
    """Is it a Dr.Jit number, vector or matrix of width 1?"""
    if not dr.is_array_v(value) or dr.is_tensor_v(value) or not dr.is_jit_v(value):
        return False
    kind = type(value)
    return (dr.depth_v(kind) == 1 or dr.size_v(kind) > 0) and dr.width(value) == 1


def is_plain(value: Any) -> bool:
    """Is it made of Python's own immutable values?"""
    return all(map(is_plain, value)) if isinstance(value, (tuple, frozenset)) else isinstance(value, PLAIN)


class Collection:
    """A traversal callback that notes which attributes are reported."""

    def __init__(self) -> None:
        self.flags: dict[str, ParamFlags] = {}

    def put(self, name: str, value: Any, flags: Any = 0, attribute: str | None = None) -> None:
        """See `djpt.description.plugin.TraversalCallback`."""
        self.flags[attribute or name] = flags


class Report:
    """The callback that a script's `traverse` sees: it finds out which attribute a reported value is kept in."""

    def __init__(self, plugin: Plugin, callback: TraversalCallback) -> None:
        self._plugin, self._callback = plugin, callback

    def put(self, name: str, value: Any, flags: Any = 0, attribute: str | None = None) -> None:
        """Report a parameter or a nested plugin, as in Mitsuba."""
        flags = plugins.ParamFlags(int(flags))
        if not isinstance(value, plugins.Plugin):
            attribute = attribute or self._attribute(name, value)
            if not is_uniform(value):  # kernels don't look it up: no gradient would arrive
                flags &= ~plugins.ParamFlags.Differentiable
        self._callback.put(name, value, flags, attribute)

    put_value = put_object = put_parameter = put

    def _attribute(self, name: str, value: Any) -> str:
        attributes = vars(self._plugin)
        holders = [name, *attributes]
        for holder in holders:
            if attributes.get(holder) is value and value is not None:
                return holder
        if hasattr(self._plugin, name):
            return name
        kind = type(self._plugin).__name__
        raise ParameterError(f"{kind}.traverse reports '{name}', but no attribute of the {kind} holds that value")


def reporting(traverse: Callable[..., None]) -> Callable[..., None]:
    """A script's `traverse`, called with a `Report`."""

    @functools.wraps(traverse)
    def wrapper(self: Plugin, callback: TraversalCallback) -> None:
        traverse(self, Report(self, callback))

    return wrapper
