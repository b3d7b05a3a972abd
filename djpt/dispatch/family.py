"""What per-lane plugins of all kinds have in common: a family of plugins, and the number of one in each lane."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import drjit as dr

from djpt.description.plugin import Plugin
from djpt.dispatch.ensemble import Detached, Ensemble, Lookup
from djpt.dispatch.lookup import Members, Numbers, choose
from djpt.errors import SceneError
from djpt.records import Record
from djpt.records.homes import Home, only
from djpt.types import Bool, UInt32

__all__ = ["ACQUAINTANCES", "NONE", "Family", "Pointer"]

NONE = 0xFFFFFFFF
"""A number that no plugin has."""

P = TypeVar("P", bound=Plugin)


@dataclass(frozen=True, eq=False)
class Family(Generic[P]):
    """Plugins that pointers choose among, and the way to read their values."""

    ensemble: Ensemble[P]
    lookup: Lookup


class Acquaintances:
    """The plugins that scripts have made pointers of, numbered; those that are gone give their number away."""

    def __init__(self) -> None:
        self._members: list[weakref.ref[Plugin]] = []
        self._families: dict[str, Strangers] = {}

    def number(self, plugin: Plugin) -> int:
        """The number of a plugin, from now on."""
        free = None
        for number, member in enumerate(self._members):
            if member() is plugin:
                return number
            if member() is None and free is None:
                free = number
        if free is None:
            self._members.append(weakref.ref(plugin))
            return len(self._members) - 1
        self._members[free] = weakref.ref(plugin)
        return free

    def members(self, kind: str) -> list[Plugin]:
        """The plugins by number; in place of those that are gone or of another kind any of the kind `kind`."""
        alive = [member() for member in self._members]
        fitting = [plugin if plugin is not None and plugin.kind == kind else None for plugin in alive]
        some = next((plugin for plugin in fitting if plugin is not None), None)
        return [] if some is None else [plugin or some for plugin in fitting]

    def of(self, lanes: Sequence[Plugin | None]) -> Strangers:
        """The family of the plugins that are of the same kind as those given: the same object every time."""
        return self.all_of(next((plugin.kind for plugin in lanes if plugin is not None), ""))

    def all_of(self, kind: str) -> Strangers:
        """The family of all plugins of a kind: the same object every time."""
        return self._families.setdefault(kind, Strangers(kind))


class Strangers:
    """A family of plugins that belong to no scene together: those of a kind that scripts have made pointers of.

    As one family they can be selected among, whenever their pointers were made.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind

    @property
    def ensemble(self) -> Ensemble[Any]:
        """The plugins as they are now."""
        return Ensemble(ACQUAINTANCES.members(self._kind))


ACQUAINTANCES = Acquaintances()


class Pointer(Record, Generic[P]):
    """A plugin per lane, or none.

    Made of a plugin or of several, one per lane (None stands for none), or without arguments: none. Pointers are
    compared with ``==`` and ``!=`` to None, to plugins, and to other pointers.
    """

    index: UInt32
    """The number of the plugin in the family; beyond the last: none."""
    home: Home
    """The `Family`."""

    def __init__(self, plugins: Any = None, **fields: Any) -> None:
        if isinstance(plugins, Pointer):
            fields = {"index": UInt32(plugins.index), "home": plugins.home, **fields}
        elif plugins is not None:
            lanes = list(plugins) if isinstance(plugins, Iterable) else [plugins]
            for plugin in lanes:
                if plugin is not None and not isinstance(plugin, Plugin):
                    raise SceneError(f"{type(self).__name__}: expected plugins, found {type(plugin).__name__}")
            numbers = [NONE if plugin is None else ACQUAINTANCES.number(plugin) for plugin in lanes]
            fields = {"index": UInt32(numbers), "home": {ACQUAINTANCES.of(lanes): ()}}
        super().__init__(None, **fields)
        # Plugins that nobody else holds must last as long as the pointer.
        self.__dict__["_held"] = plugins

    @classmethod
    def into(cls, family: Family[P], index: UInt32) -> Any:
        """The members of a family with the numbers `index`."""
        return cls.holding(index=index, home={family: ()})

    def default(self, name: str) -> Any:
        return UInt32(NONE) if name == "index" else {}

    def zero_(self, size: int = 1) -> None:
        """Complete `dr.zeros`: no plugin."""
        self.index = dr.full(UInt32, NONE, size)

    # ---- the family -----------------------------------------------------------------------

    @property
    def ensemble(self) -> Ensemble[P]:
        """The plugins, grouped by what kernels know of them."""
        family = only(tuple(self.home))
        return NOBODY if family is None else family.ensemble

    @property
    def lookup(self) -> Lookup:
        """The way to read the plugins' values."""
        family = only(tuple(self.home))
        return Detached() if family is None or isinstance(family, Strangers) else family.lookup

    @property
    def plugins(self) -> Sequence[P]:
        """The plugins that lanes choose among."""
        return self.ensemble.plugins

    def is_valid(self) -> Bool:
        """True where there is a plugin."""
        return self.index < len(self.plugins)

    def number(self, of: Callable[[P], int]) -> UInt32:
        """A whole number per lane that is known when kernels are traced; unspecified where there is no plugin."""
        numbers = [of(plugin) for plugin in self.plugins]
        return choose(self.index, [UInt32(n) for n in numbers], numbers) if numbers else UInt32(0)

    def holds(self, of: Callable[[P], bool]) -> Bool:
        """True where there is a plugin that has a property which is known when kernels are traced."""
        return Members([i for i, plugin in enumerate(self.plugins) if of(plugin)], len(self.plugins)).contain(
            dr.minimum(self.index, len(self.plugins))
        )

    def related(self, kind: type[Any], of: Callable[[P], Plugin | None]) -> Any:
        """The pointers of type `kind` to a plugin that each of these has; none where there is none."""
        others = [of(plugin) for plugin in self.plugins]
        members = list({id(other): other for other in others if other is not None}.values())
        place = {id(other): i for i, other in enumerate(members)}
        numbers = Numbers([place.get(id(other), NONE) for other in others] + [NONE])
        index = numbers.at(dr.minimum(self.index, len(others)))
        return kind.into(Family(Ensemble(members), self.lookup), index)

    # ---- lane by lane -----------------------------------------------------------------------

    def at(self, lane: int) -> P | None:
        """The plugin of a lane, or None. (Dr.Jit would take what has an operator ``[]`` for a sequence.)"""
        number = self.index[lane]
        return self.plugins[number] if number < len(self.plugins) else None

    def __eq__(self, other: object) -> Any:
        if isinstance(other, Pointer):
            place = {identity(plugin): i for i, plugin in reversed(list(enumerate(self.plugins)))}
            same = Numbers([place.get(identity(plugin), NONE - 1) for plugin in other.plugins] + [NONE])
            mine = dr.select(self.is_valid(), self.index, NONE)
            return mine == same.at(dr.minimum(other.index, len(other.plugins)))
        if other is None:
            return ~self.is_valid()
        origin = identity(other)
        return self.holds(lambda plugin: identity(plugin) == origin)

    def __ne__(self, other: object) -> Any:
        return ~(self == other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr([self.at(lane) for lane in range(dr.width(self.index))])


def identity(plugin: Any) -> int:
    """A number that a plugin shares with the copies of it that are made to be asked alone."""
    return id(getattr(plugin, "original", None) or plugin)


NOBODY: Ensemble[Any] = Ensemble([])
"""The family of pointers that were made of nothing."""
