"""Calling plugins per lane: each structure is traced once, values are looked up.

An `Ensemble` holds the plugins of one kind that a scene refers to by index. Plugins with
equal class, statics and children form a *group*: their methods are traced once, on a
*representative*, a shallow copy of a member whose values are per-lane lookups. So a scene
with a hundred diffuse materials traces one diffuse BSDF, and editing a value (the arrays
of `Plugin.values`) never changes a kernel.

How values are looked up is the ensemble's `Lookup`:

* `Detached` selects among opaque copies (or gathers, if there are many): rendering.
* `Attached` gathers from a buffer that stays attached to the parameters: plain AD.
* `djpt.rendering.gradients.leaves` adds one that makes fresh AD leaves at each path vertex: path replay.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar
from weakref import WeakKeyDictionary

import drjit as dr
import numpy as np

from djpt.core.lookup import Flat, Members, Numbers, Rows
from djpt.description.plugin import Plugin
from djpt.dispatch.tables import Buffer, channels_of
from djpt.jit.frozen import recording
from djpt.jit.kernels import if_stmt, may_wait, opaque
from djpt.jit.types import Bool, Float, UInt32

__all__ = [
    "Attached",
    "Detached",
    "Ensemble",
    "Group",
    "Leaf",
    "Lookup",
    "TableLeaf",
    "followed",
    "is_attached",
    "may_vanish",
    "prepare_followed",
    "structure",
]

P = TypeVar("P", bound=Plugin)


def structure(plugin: Plugin) -> Hashable:
    """The structure of a plugin for kernels: class, statics, types of values, and the structure of its children."""
    children = []
    for name in plugin.children:
        child = getattr(plugin, name)
        children.append(structure(child) if isinstance(child, Plugin) else child)
    statics = tuple(getattr(plugin, name) for name in plugin.statics)
    value_types = tuple(type(getattr(plugin, name)) for name in plugin.values)
    channels = tuple(channels_of(getattr(plugin, name)) for name in plugin.tables)
    return (type(plugin), statics, value_types, channels, tuple(children))


@dataclass(frozen=True)
class Leaf:
    """One value of a group: the plugins that hold it, and the attribute that they hold it in."""

    owners: tuple[Plugin, ...]
    """The plugin that holds the value, for each member of the group."""
    attribute: str

    def rows(self) -> list[Any]:
        """The current values, one per member."""
        return [getattr(owner, self.attribute) for owner in self.owners]

    def identity(self) -> list[Hashable]:
        """The identity of each value: members that share the plugin share the value."""
        return [id(owner) for owner in self.owners]


class TableLeaf(Leaf):
    """A leaf whose values are tensors; looking it up gives a `Table`."""


class Lookup(Protocol):
    """The way in which kernels read the values of a group."""

    def __call__(self, leaf: Leaf, slot: UInt32) -> Any:
        """The value of `leaf` for the member number `slot` of its group."""

    def attaches(self, leaf: Leaf) -> bool:
        """True if looked-up values of `leaf` are AD leaves, or depend on some."""

    def vanishing_members(self, leaf: Leaf) -> list[int]:
        """The members of the group whose values of `leaf` are AD leaves that may make a factor of paths vanish."""

    def plain(self) -> Lookup:
        """A lookup of the same values that attaches none."""


@dataclass
class BufferTable:
    """One member's tensor in the buffer of its group."""

    buffer: Buffer
    slot: UInt32

    @property
    def attached(self) -> bool:
        """True if the entries depend on AD leaves."""
        return self.buffer.attached

    def at(self, index: UInt32, active: Bool | bool = True) -> Any:
        """Entry number `index` of the tensor."""
        return self.buffer.read(self.buffer.address(self.slot, index), active)


class Detached:
    """Lookups in opaque copies of the values, made when first used and kept until `forget`."""

    def __init__(self) -> None:
        self._copies: dict[tuple[int, str], Any] = {}
        self._tables: dict[int, tuple[Leaf, Any]] = {}
        self._vanishing: dict[tuple[int, str], bool] = {}

    def prepare(self, leaves: Iterable[Leaf]) -> None:
        """Build the tables of some leaves. Long ones must exist before a kernel's loop asks for them."""
        for leaf in leaves:
            self._table(leaf)

    def _table(self, leaf: Leaf) -> Any:
        if id(leaf) not in self._tables:
            if isinstance(leaf, TableLeaf):
                table: Any = Buffer([dr.detach(tensor) for tensor in leaf.rows()], leaf.identity())
            else:
                table = Rows([self.value(owner, leaf.attribute) for owner in leaf.owners], leaf.identity())
            # The leaf is kept beside its table so that its id stays taken.
            self._tables[id(leaf)] = (leaf, table)
        return self._tables[id(leaf)][1]

    def buffer(self, leaf: TableLeaf) -> Buffer:
        """The tensors of a leaf."""
        return self._table(leaf)

    def value(self, owner: Plugin, attribute: str) -> Any:
        """The opaque copy of one plugin's value."""
        key = (id(owner), attribute)
        if key not in self._copies:
            self._copies[key] = opaque(getattr(owner, attribute))
        return self._copies[key]

    def snapshot(self, needed: Sequence[tuple[Plugin, str]]) -> Detached:
        """A copy that holds the `needed` values as they are now, whatever happens to the plugins."""
        clone = Detached()
        for owner, attribute in needed:
            if attribute in owner.values:  # tables are there already
                self.value(owner, attribute)
        clone._copies, clone._tables = dict(self._copies), dict(self._tables)
        # Shared until either forgets: what one has read from the device the other needn't wait for.
        clone._vanishing = self._vanishing
        return clone

    def vanishes(self, owner: Plugin, attribute: str) -> bool:
        """True if a plugin's value may make a factor of paths vanish: see `may_vanish`."""
        if recording():
            return True
        key = (id(owner), attribute)
        if key not in self._vanishing:
            with may_wait():
                self._vanishing[key] = may_vanish(dr.detach(getattr(owner, attribute)))
        return self._vanishing[key]

    def forget(self) -> None:
        """Drop the copies of values that have changed: the next use reads them again."""
        self._copies.clear()
        self._tables.clear()
        self._vanishing = {}

    def __call__(self, leaf: Leaf, slot: UInt32) -> Any:
        table = self._table(leaf)
        return BufferTable(table, slot) if isinstance(leaf, TableLeaf) else table.at(slot)

    def attaches(self, leaf: Leaf) -> bool:
        return False

    def vanishing_members(self, leaf: Leaf) -> list[int]:
        return []

    def plain(self) -> Detached:
        return self


class Attached:
    """Lookups by gathers from buffers that are attached to AD variables in place of some of the values."""

    def __init__(self, overrides: dict[tuple[int, str], Any]) -> None:
        """`overrides` maps (id of a plugin, attribute) to the attached value; all other values are detached."""
        self._overrides = overrides
        self._flats: dict[int, tuple[Leaf, Any]] = {}
        self._vanishing: dict[tuple[int, str], bool] = {}
        self._plain = Attached({}) if overrides else self

    def plain(self) -> Attached:
        return self._plain

    def variables(self) -> list[Any]:
        """The attached values."""
        return list(self._overrides.values())

    def attaches(self, leaf: Leaf) -> bool:
        return any((id(owner), leaf.attribute) in self._overrides for owner in leaf.owners)

    def vanishing_members(self, leaf: Leaf) -> list[int]:
        return [k for k, owner in enumerate(leaf.owners) if self._vanishes((id(owner), leaf.attribute))]

    def _vanishes(self, place: tuple[int, str]) -> bool:
        if place not in self._vanishing:
            self._vanishing[place] = place in self._overrides and may_vanish(self._overrides[place])
        return self._vanishing[place]

    def prepare(self, leaves: Iterable[Leaf]) -> None:
        """Build the buffers of some leaves, which loops that Dr.Jit records can't do."""
        for leaf in leaves:
            self._buffer(leaf)
            self._plain._buffer(leaf)

    def __call__(self, leaf: Leaf, slot: UInt32) -> Any:
        found = self._buffer(leaf)
        return BufferTable(found, slot) if isinstance(leaf, TableLeaf) else found.at(slot)

    def _buffer(self, leaf: Leaf) -> Any:
        if id(leaf) not in self._flats:
            rows = [
                self._overrides.get((id(owner), leaf.attribute), dr.detach(getattr(owner, leaf.attribute)))
                for owner in leaf.owners
            ]
            # The leaf is kept beside its buffer so that its id stays taken.
            table = Buffer(rows, leaf.identity()) if isinstance(leaf, TableLeaf) else Flat(rows)
            self._flats[id(leaf)] = (leaf, table)
        return self._flats[id(leaf)][1]


NEARLY = 2e-3
"""The distance from 0 or 1 within which a value may make a factor too small to divide by."""


def may_vanish(value: Any) -> bool:
    """True if one of the numbers is nearly 0 or 1, so that a factor of paths, itself or its complement, may vanish.

    While a frozen function is recorded numbers can't be read: then it is true.
    """
    if recording():
        return True
    # A literal becomes memory first: read from it, it would be a part of a kernel.
    distance = np.abs(np.array(opaque(value)))
    return bool(np.any((distance < NEARLY) | (np.abs(distance - 1) < NEARLY)))


class Group(Generic[P]):
    """The members of an ensemble that share one structure."""

    def __init__(self, plugins: Sequence[P], indices: Sequence[int]) -> None:
        self.plugins = tuple(plugins)
        self.indices = tuple(indices)
        self._tree = self._collect(self.plugins)

    @classmethod
    def _collect(cls, owners: Sequence[Plugin]) -> dict[str, Any]:
        tree: dict[str, Any] = {name: Leaf(tuple(owners), name) for name in owners[0].values}
        tree.update({name: TableLeaf(tuple(owners), name) for name in owners[0].tables})
        for name in owners[0].children:
            if isinstance(getattr(owners[0], name), Plugin):
                tree[name] = cls._collect([getattr(owner, name) for owner in owners])
        return tree

    def leaves(self) -> list[Leaf]:
        """All values of the group, children's included."""
        return leaves_of(self._tree)

    def at(self, slot: UInt32, lookup: Lookup) -> P:
        """The representative whose values belong to member `slot` of this group."""
        return representative(self.plugins[0], self._tree, slot, lookup)


def is_attached(group: Group[Any], lookup: Lookup) -> bool:
    """True if the group's methods compute with AD leaves."""
    return any(lookup.attaches(leaf) for leaf in group.leaves())


# These two are functions of the module because recursive closures are reference cycles: they would
# keep `slot`, and with it whole graphs of Dr.Jit variables, alive until the garbage collector runs.


def leaves_of(tree: dict[str, Any]) -> list[Leaf]:
    """The leaves of a group's tree."""
    found: list[Leaf] = []
    for node in tree.values():
        found += leaves_of(node) if isinstance(node, dict) else [node]
    return found


def representative(plugin: Any, tree: dict[str, Any], slot: UInt32, lookup: Lookup) -> Any:
    """A shallow copy of `plugin` and of its children, with looked-up values."""
    # As by `copy.copy`, which takes a dozen times as long.
    clone = object.__new__(type(plugin))
    clone.__dict__.update(plugin.__dict__)
    for name, node in tree.items():
        if isinstance(node, dict):
            value = representative(getattr(plugin, name), node, slot, lookup)
        else:
            value = lookup(node, slot)
        setattr(clone, name, value)
    return clone


class Ensemble(Generic[P]):
    """Plugins of one kind, addressed by a per-lane index."""

    def __init__(self, plugins: Sequence[P]) -> None:
        self.plugins = tuple(plugins)
        by_structure: dict[Hashable, list[int]] = {}
        for i, plugin in enumerate(self.plugins):
            by_structure.setdefault(structure(plugin), []).append(i)
        self.groups = [Group([self.plugins[i] for i in ids], ids) for ids in by_structure.values()]
        self._keys = list(zip(by_structure, self.groups, strict=True))
        self._members = {id(group): Members(group.indices, len(self.plugins)) for group in self.groups}
        self._slots = {id(group): Numbers(self._positions(group)) for group in self.groups}

    def is_current(self) -> bool:
        """True if all plugins still have the structure of their group."""
        return all(structure(plugin) == key for key, group in self._keys for plugin in group.plugins)

    def _positions(self, group: Group[P]) -> list[int]:
        position = {i: k for k, i in enumerate(group.indices)}
        return [position.get(i, 0) for i in range(len(self.plugins))]

    def leaves(self) -> list[Leaf]:
        """All values of all groups."""
        return [leaf for group in self.groups for leaf in group.leaves()]

    def vanishing(self, lookup: Lookup) -> list[int]:
        """The numbers of the plugins that compute with AD leaves which may make a factor of paths vanish."""
        found = {
            group.indices[k] for group in self.groups for leaf in group.leaves() for k in lookup.vanishing_members(leaf)
        }
        return sorted(found)

    def __len__(self) -> int:
        return len(self.plugins)

    def slots(self, group: Group[P], index: UInt32) -> UInt32:
        """The position of plugin number `index` within `group`; unspecified for members of other groups."""
        first = group.indices[0]
        if list(group.indices) == list(range(first, first + len(group.indices))):
            return index - first if first else index
        return self._slots[id(group)].at(index)

    def call(
        self,
        index: UInt32,
        lookup: Lookup,
        method: Callable[[P], Any],
        otherwise: Any,
        active: Bool | None = None,
    ) -> Any:
        """``method(plugin)`` per lane; `otherwise` where `index` is beyond the last plugin.

        The first group's method is evaluated for all lanes. So are the others', unless `active` lanes are
        given: they are then branches, which a packet of lanes skips if none of its active lanes needs them.
        `method` must return a PyTree of the type of `otherwise`.
        """
        groups = self.groups
        if active is not None:
            # Attached results must not pass through the branches of other groups: those come first.
            groups = sorted(groups, key=lambda group: is_attached(group, lookup))
        result = otherwise
        for number, group in enumerate(groups):

            def evaluate(group: Group[P] = group) -> Any:
                return method(group.at(self.slots(group, index), lookup))

            if number == 0 and otherwise is None:
                result = evaluate()
                continue
            mine = self.members(group, index)
            # The leaves of a branch couldn't be differentiated from outside of it.
            if active is None or is_attached(group, lookup):
                result = dr.select(mine, evaluate(), result)
            else:
                (result,) = if_stmt(
                    (result,), mine & active, lambda result: (evaluate(),), lambda result: (result,), label="bsdf"
                )
        return result

    def members(self, group: Group[P], index: UInt32) -> Bool:
        """True where plugin number `index` belongs to `group`."""
        return self._members[id(group)].contain(index)


_latest: WeakKeyDictionary[Ensemble[Any], tuple[Any, Attached]] = WeakKeyDictionary()
"""The lookups that were made last for each ensemble, with the values that they were made for: for use in loops."""


def is_tracking() -> bool:
    """True if gradients are tracked here, and not suspended."""
    probe = Float(0)
    dr.enable_grad(probe)
    return bool(dr.grad_enabled(probe))


def followed(ensemble: Ensemble[Any], values: Lookup) -> Lookup:
    """`values`, or if some values of the ensemble have gradients, and these are tracked, lookups attached to them.

    Rendering suspends the tracking of gradients and attaches what it differentiates itself. A script that evaluates a
    BSDF where gradients are tracked expects the result to depend on the parameters of the scene.

    Within a loop that Dr.Jit records tables can't be made: there it is `values`, unless there are tables from before.
    Outside of loops they are made anew, because a traversal cuts the way from them to the values.
    """
    if type(values) is not Detached or not is_tracking():
        return values
    found = {
        (id(owner), leaf.attribute): value
        for leaf in ensemble.leaves()
        for owner in leaf.owners
        if dr.grad_enabled(value := getattr(owner, leaf.attribute))
    }
    if not found:
        return values
    key = dr.detail.collect_indices(list(found.values()))
    if dr.flag(dr.JitFlag.SymbolicScope):
        made = _latest.get(ensemble)
        return made[1] if made is not None and made[0] == key else values
    attached = Attached(found)
    attached.prepare(ensemble.leaves())
    _latest[ensemble] = key, attached
    return attached


def prepare_followed(ensembles: Iterable[Ensemble[Any]], values: Lookup) -> None:
    """Make the tables that a script's loop will need if it tracks gradients."""
    if type(values) is not Detached or dr.flag(dr.JitFlag.SymbolicScope):
        return
    with dr.resume_grad():
        for ensemble in ensembles:
            followed(ensemble, values)
