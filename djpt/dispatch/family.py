"""What per-lane plugins of all kinds have in common: a family of plugins, and the number of one in each lane."""

from __future__ import annotations

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

__all__ = ["NONE", "Family", "Pointer"]

NONE = 0xFFFFFFFF
"""A number that no plugin has."""

P = TypeVar("P", bound=Plugin)


@dataclass(frozen=True, eq=False)
class Family(Generic[P]):
    """Plugins that pointers choose among, and the way to read their values."""

    ensemble: Ensemble[P]
    lookup: Lookup


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
            members = list({id(plugin): plugin for plugin in lanes if plugin is not None}.values())
            numbers = [NONE if plugin is None else members.index(plugin) for plugin in lanes]
            fields = {"index": UInt32(numbers), "home": {Family(Ensemble(members), Detached()): ()}}
        super().__init__(None, **fields)

    @classmethod
    def into(cls, family: Family[P], index: UInt32) -> Any:
        """The members of a family with the numbers `index`."""
        pointer = cls()
        pointer.index, pointer.home = index, {family: ()}
        return pointer

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
        return Detached() if family is None else family.lookup

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

    # ---- as a sequence ----------------------------------------------------------------------

    def __len__(self) -> int:
        return int(dr.width(self.index))

    def __getitem__(self, lane: int) -> P | None:
        number = self.index[lane]
        return self.plugins[number] if number < len(self.plugins) else None

    def __eq__(self, other: object) -> Any:
        if isinstance(other, Pointer):
            place = {id(plugin): i for i, plugin in enumerate(self.plugins)}
            same = Numbers([place.get(id(plugin), NONE - 1) for plugin in other.plugins] + [NONE])
            mine = dr.select(self.is_valid(), self.index, NONE)
            return mine == same.at(dr.minimum(other.index, len(other.plugins)))
        if other is None:
            return ~self.is_valid()
        return self.holds(lambda plugin: plugin is other)

    def __ne__(self, other: object) -> Any:
        return ~(self == other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr([self[lane] for lane in range(len(self))])


NOBODY: Ensemble[Any] = Ensemble([])
"""The family of pointers that were made of nothing."""
