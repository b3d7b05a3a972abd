"""The base of per-lane plugins of all kinds: a family of plugins, and the number of one in each lane."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

import drjit as dr
import numpy as np

from djpt.core.lookup import MAX_CHAIN, Members, Numbers, choose, is_one_of, runs
from djpt.core.records import DirectionSample3f, Ray3f, Record
from djpt.core.records.record import SceneRef, only
from djpt.description.plugin import Plugin
from djpt.dispatch.ensemble import Detached, Ensemble, Lookup, followed
from djpt.errors import SceneError
from djpt.jit.types import Bool, Float, UInt32

__all__ = ["NONE", "SCRIPT_PLUGINS", "Family", "Pointer", "filled"]

NONE = 0xFFFFFFFF
"""A number that no plugin has."""

P = TypeVar("P", bound=Plugin)


@dataclass(frozen=True, eq=False)
class Family(Generic[P]):
    """Plugins that pointers choose among, and the way in which rendering reads their values."""

    ensemble: Ensemble[P]
    values: Lookup

    @property
    def lookup(self) -> Lookup:
        """The way to read the plugins' values: so that gradients follow, where they are tracked."""
        return followed(self.ensemble, self.values)


class ScriptPlugins:
    """The plugins that scripts have made pointers of, numbered; those that are gone give their number away.

    One list for the process, as Dr.Jit's own registry: pointers can only be selected among, and carried by loops, if
    they are numbers of one family, and a script makes them one by one, of plugins that belong to no scene.
    """

    def __init__(self) -> None:
        self._members: list[weakref.ref[Plugin]] = []
        self._families: dict[str, Unowned] = {}

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

    def of(self, kind: str) -> Unowned:
        """The family of the plugins of a kind: the same object every time."""
        return self._families.setdefault(kind, Unowned(kind))


class Unowned:
    """A family of plugins that belong to no scene together: those of a kind that scripts have made pointers of.

    As one family they can be selected among, whenever their pointers were made.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind

    @property
    def ensemble(self) -> Ensemble[Any]:
        """The plugins as they are now."""
        return Ensemble(SCRIPT_PLUGINS.members(self._kind))


SCRIPT_PLUGINS = ScriptPlugins()


class Pointer(Record, Generic[P]):
    """A plugin per lane, or none.

    Made of a plugin or of several, one per lane (None stands for none), or without arguments: none. Pointers are
    compared with ``==`` and ``!=`` to None, to plugins, and to other pointers.

    What `dr.zeros` makes is none, and goes together with pointers that scripts make of plugins (in `dr.select`,
    `dr.scatter` and loops).
    """

    member_kind: ClassVar[str] = ""
    """The `Plugin.kind` of what it points to."""

    index: UInt32
    """The number of the plugin in the family; beyond the last: none."""
    scene_ref: SceneRef
    """The `Family`."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "member_kind" in vars(cls):
            POINTERS[cls.member_kind] = cls

    @staticmethod
    def of_kind(kind: str) -> type[Pointer[Any]]:
        """The class of pointers to a kind of plugins; the base, which asks them nothing, if none was imported yet."""
        return POINTERS.get(kind, Pointer)

    def __init__(self, plugins: Any = None, **fields: Any) -> None:
        if isinstance(plugins, Pointer):
            fields = {"index": UInt32(plugins.index), "scene_ref": plugins.scene_ref, **fields}
        elif plugins is not None:
            lanes = list(plugins) if isinstance(plugins, Iterable) else [plugins]
            for plugin in lanes:
                if plugin is not None and not isinstance(plugin, Plugin):
                    raise SceneError(f"{type(self).__name__}: expected plugins, found {type(plugin).__name__}")
            numbers = [SCRIPT_PLUGINS.number(plugin) if self.may_hold(plugin) else NONE for plugin in lanes]
            kind = next((plugin.kind for plugin in lanes if plugin is not None), self.member_kind)
            fields = {"index": UInt32(numbers), "scene_ref": {SCRIPT_PLUGINS.of(kind): ()}}
        super().__init__(None, **fields)
        # Plugins that nobody else holds must last as long as the pointer.
        self.__dict__["_held"] = plugins

    @classmethod
    def into(cls, family: Family[P], index: UInt32) -> Any:
        """The members of a family with the numbers `index`."""
        return cls.holding(index=index, scene_ref={family: ()})

    def default(self, name: str) -> Any:
        return UInt32(NONE) if name == "index" else {}

    def zero_(self, size: int = 1) -> None:
        """Complete `dr.zeros`: no plugin."""
        self.index, self.scene_ref = dr.full(UInt32, NONE, size), {SCRIPT_PLUGINS.of(self.member_kind): ()}

    @classmethod
    def may_hold(cls, plugin: Plugin | None) -> bool:
        """True if pointers of this type point to a plugin; to None, and to others, they don't."""
        return plugin is not None

    # ---- the family -----------------------------------------------------------------------

    @property
    def ensemble(self) -> Ensemble[P]:
        """The plugins, grouped by what kernels know of them."""
        family = only(tuple(self.scene_ref))
        return NOBODY if family is None else family.ensemble

    @property
    def lookup(self) -> Lookup:
        """The way to read the plugins' values; those of a script's own plugins stay attached to their gradients."""
        if self.is_of_script:
            return followed(self.ensemble, Detached())
        family: Family[P] = only(tuple(self.scene_ref))
        return family.lookup

    @property
    def is_of_script(self) -> bool:
        """True if a script has made the pointer, not a scene."""
        return not isinstance(only(tuple(self.scene_ref)), Family)

    @property
    def plugins(self) -> Sequence[P]:
        """The plugins that lanes choose among."""
        return self.ensemble.plugins

    def is_valid(self) -> Bool:
        """True where there is a plugin."""
        return self.index < len(self.plugins)

    @staticmethod
    def branching(active: Bool | bool, *inputs: Any) -> Bool | None:
        """The `active` lanes for a dispatch by branches (`Ensemble.call`); None, all lanes, if an input is attached.

        The derivatives of a branch by what it captures would be those of all lanes, not of those that take it.
        """
        return None if dr.grad_enabled(*inputs) else Bool(active)

    def number(self, of: Callable[[P], int]) -> UInt32:
        """A whole number per lane that is known when kernels are traced; unspecified where there is no plugin."""
        numbers = [of(plugin) for plugin in self.plugins]
        return choose(self.index, [UInt32(n) for n in numbers], numbers) if numbers else UInt32(0)

    def holds(self, of: Callable[[P], bool]) -> Bool:
        """True where there is a plugin that has a property which is known when kernels are traced."""
        return Members([i for i, plugin in enumerate(self.plugins) if of(plugin)], len(self.plugins)).contain(
            dr.minimum(self.index, len(self.plugins))
        )

    def vanishes(self) -> Bool:
        """True where AD leaves of the plugin may make a factor of paths vanish; if such plugins are many, anywhere."""
        found = self.ensemble.vanishing(self.lookup)
        if len(found) == len(self.plugins) or len(runs(found)) > MAX_CHAIN:
            return Bool(True)
        return is_one_of(self.index, found)

    def each(self, method: Callable[[P, Bool], Any], otherwise: Any) -> Any:
        """The results ``method(plugin, mine)`` per lane, `mine` being the lanes of the plugin; else `otherwise`.

        For questions that plugins of one structure can't be asked together (see `Ensemble.call`).
        """
        result = otherwise
        for i in self.present():
            mine = self.index == i
            result = dr.select(mine, method(self.plugins[i], mine), result)
        return result

    def present(self) -> Sequence[int]:
        """The numbers of the plugins that lanes point to; of all if lanes can't be looked at yet."""
        known = self.index.state in (dr.VarState.Literal, dr.VarState.Evaluated)
        if not known or dr.flag(dr.JitFlag.FreezingScope):
            return range(len(self.plugins))
        return [int(i) for i in np.unique(np.array(self.index)) if i < len(self.plugins)]

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

    def __len__(self) -> int:
        return dr.width(self.index)

    def __bool__(self) -> bool:
        return True

    def __eq__(self, other: object) -> Any:
        if isinstance(other, Pointer):
            place = {identity(plugin): i for i, plugin in enumerate(self.plugins)}
            mine = Numbers([place[identity(plugin)] for plugin in self.plugins] + [NONE])
            same = Numbers([place.get(identity(plugin), NONE - 1) for plugin in other.plugins] + [NONE])
            theirs = same.at(dr.minimum(other.index, len(other.plugins)))
            return mine.at(dr.minimum(self.index, len(self.plugins))) == theirs
        if other is None:
            return ~self.is_valid()
        origin = identity(other)
        return self.holds(lambda plugin: identity(plugin) == origin)

    def __ne__(self, other: object) -> Any:
        return ~(self == other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr([self.at(lane) for lane in range(dr.width(self.index))])


def filled(result: tuple[Any, Any], time: Any = None) -> tuple[Any, Any]:
    """A sample and its weight, whose fields of which some records have none are made the same for all."""
    sample, weight = result
    if isinstance(sample, Ray3f):
        return sample.replaced(times=(Float(time),), media=()), weight
    if isinstance(sample, DirectionSample3f):
        return sample.replaced(scene_ref={}), weight
    return sample, weight


def identity(plugin: Any) -> int:
    """A number that a plugin shares with the copies of it that are made to be asked alone."""
    return id(getattr(plugin, "original", None) or plugin)


POINTERS: dict[str, type[Pointer[Any]]] = {}
"""The class of pointers to each kind of plugins, as far as imported: each enters itself, as plugins do."""

NOBODY: Ensemble[Any] = Ensemble([])
"""The family of pointers that were made of nothing."""
