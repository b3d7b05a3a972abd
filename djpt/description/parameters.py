"""`traverse()`: read and edit the parameters of a plugin tree under Mitsuba's names."""

from __future__ import annotations

import re
import weakref
from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.numeric import AttachedNumber, as_array, as_integer, as_number, describe
from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback
from djpt.errors import DjptError, ParameterError, SceneError, near_miss
from djpt.jit.frozen import Held, Structure, hold_garbage, recording
from djpt.jit.kernels import may_wait

__all__ = ["NEWER_NAMES", "SCENES", "SceneParameters", "traverse"]


def traverse(node: Plugin) -> SceneParameters:
    """The parameters of `node` and of all that is nested in it, by name.

    Names are Mitsuba's: the path of scene names and attributes, such as
    ``white.reflectance.value``. A plugin that is used in several places appears once, under
    its first path.

    Raises:
        ParameterError: `node` isn't a djpt plugin.
    """
    if not isinstance(node, Plugin):
        raise ParameterError(f"traverse: expected a plugin that djpt.load_dict made, found {describe(node)}")
    hold_garbage()
    walk = Walk(node)
    return SceneParameters(node, walk.entries, walk.parents)


@dataclass(frozen=True)
class Entry:
    """The place of a parameter: its owner, and the owner's attribute."""

    owner: Plugin
    name: str
    """The parameter's name, as the owner reported it."""
    attribute: str
    flags: ParamFlags
    path: tuple[str, ...]
    """Names of the plugins between the root and the owner."""

    def read(self) -> Any:
        return getattr(self.owner, self.attribute)

    def write(self, value: Any) -> None:
        setattr(self.owner, self.attribute, value)

    def is_computed(self) -> bool:
        """True if the value is computed anew at each read."""
        return isinstance(getattr(type(self.owner), self.attribute, None), property)


SCENES: weakref.WeakKeyDictionary[Any, frozenset[int]] = weakref.WeakKeyDictionary()
"""The scenes that there are, each entered by itself, with the identities of what has parameters in them.

These are found when a part of some scene is first edited by itself: plugins don't know the scenes that they are in.
"""

NEWER_NAMES = {
    "positions": ("vertex_positions", 3),
    "normals": ("vertex_normals", 3),
    "texcoords": ("vertex_texcoords", 2),
}
"""Names of Mitsuba 3.10 for tensors with a row per vertex: those of the same numbers as flat arrays, and columns."""


@dataclass(frozen=True)
class RowsEntry(Entry):
    """A flat array of numbers under its newer name: read and written as a tensor with a row per vertex."""

    columns: int

    def read(self) -> Any:
        numbers = super().read()
        tensor: Any = dr.tensor_t(type(numbers))
        return tensor(numbers, (dr.width(numbers) // self.columns, self.columns))

    def write(self, value: Any) -> None:
        super().write(value.array)

    def is_computed(self) -> bool:
        return True


class Loan:
    """A value that a caller has read, and may have edited in place.

    A transform is lent as a copy on lanes, as scripts expect it; anything else as it is.
    """

    def __init__(self, source: Any) -> None:
        self.source = source
        self.value = value = lent(source)
        self.is_copy = value is not source
        # Copies also keep the Dr.Jit indices taken, so that an equal index means an equal value.
        self.before = type(value)(value) if dr.is_array_v(value) else source
        self._kept = type(value)(value) if self.is_copy else None
        self.state = state_of(value)

    def is_edited(self) -> bool:
        """True if the value has changed since the caller read it."""
        return state_of(self.value) != self.state


def lent(value: Any) -> Any:
    """The value of a parameter as callers get it: a transform of Dr.Jit matrices for one on the host, else itself."""
    if not isinstance(value, ScalarTransform4f):
        return value
    from djpt.core.transforms.lanes import Transform4f

    # One with gradients knows what it was made from.
    return Transform4f(getattr(value, "lanes", value))


class Walk:
    """One traversal: the parameters in order, and every plugin's parent."""

    def __init__(self, root: Plugin) -> None:
        self.entries: dict[str, Entry] = {}
        self.parents: dict[int, Plugin | None] = {id(root): None}
        root.traverse(Visit(self, root, (), ParamFlags.Differentiable))


class Visit(TraversalCallback):
    """The traversal callback of one plugin."""

    def __init__(self, walk: Walk, node: Plugin, path: tuple[str, ...], inherited: ParamFlags) -> None:
        self.walk, self.node, self.path = walk, node, path
        self.inherited = inherited
        """The flags that those who nest the plugin add to its parameters'."""

    def put(
        self,
        name: str,
        value: Any,
        flags: ParamFlags | None = None,
        attribute: str | None = None,
    ) -> None:
        """Add a parameter or a nested plugin: see `djpt.description.plugin.TraversalCallback`."""
        if isinstance(value, Plugin):
            if id(value) not in self.walk.parents:
                self.walk.parents[id(value)] = self.node
                inherited = self.inherited | ParamFlags(int(flags or 0))
                value.traverse(Visit(self.walk, value, (*self.path, name), inherited))
            return
        key = ".".join((*self.path, name))
        flags = self.inherited | (ParamFlags.NonDifferentiable if flags is None else flags)
        if not self.inherited.differentiable:
            flags &= ~ParamFlags.Discontinuous
        self.walk.entries[key] = Entry(self.node, name, attribute or name, flags, self.path)


def follow(places: Set[tuple[int, str]]) -> None:
    """Bring the scenes up to date that hold what was edited by itself: attributes of owners, by their identities."""
    owners = {owner for owner, _ in places}
    for scene, parts in list(SCENES.items()):
        if parts and owners.isdisjoint(parts):
            continue
        params = traverse(scene)
        SCENES[scene] = frozenset(id(entry.owner) for entry in params._entries.values())
        for key, entry in params._entries.items():
            if (id(entry.owner), entry.attribute) in places:
                params.set_dirty(key)
        params.update()


class SceneParameters(Mapping[str, Any]):
    """A dict-like view of parameters; made by `traverse`. ``SceneParameters()`` has none.

    Assigning (``params[key] = value``) converts numbers, lists, NumPy and Mitsuba arrays to the
    parameter's type, checks the value, and writes it to the plugin; Dr.Jit arrays stay attached to
    their gradients. After the last assignment call `update`, which recomputes what depends on the
    changed values. In-place edits (``params[key] *= 2``, `dr.enable_grad`) are noticed as well, except
    writes through `dr.scatter`: call `set_dirty` after those.

    Scenes follow edits of their parts, too, which takes a walk through each scene that holds them.
    Iterating yields the keys, as any mapping does (Mitsuba yields pairs: use `items`).

    Of meshes, the names of Mitsuba 3.10 are understood, too: `positions`, `normals` and `texcoords` are tensors with a
    row per vertex over what `vertex_positions`, `vertex_normals` and `vertex_texcoords` hold as flat arrays. Keys
    that are listed are the flat ones.
    """

    DRJIT_STRUCT = Held()

    def __init__(
        self,
        root: Plugin | None = None,
        entries: Mapping[str, Entry] | None = None,
        parents: Mapping[int, Plugin | None] | None = None,
    ) -> None:
        self._root = Plugin() if root is None else root
        self._entries = dict(entries or {})
        self._parents = parents or {}
        self._lent: dict[str, Loan] = {}
        self._dirty: dict[str, tuple[Entry, Any]] = {}
        """The parameters that have changed since the last update, with the values that they had before."""

    # ---- reading -----------------------------------------------------------------------

    def __getitem__(self, key: str) -> Any:
        entry = self._entry(key)
        loan, value = self._lent.get(key), entry.read()
        if loan is None or not (loan.source is value or entry.is_computed()):
            loan = self._lent[key] = Loan(value)
        return loan.value

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, key: object) -> bool:
        return isinstance(key, str) and (key in self._entries or self._older_name(key) in self._entries)

    def flags(self, key: str) -> ParamFlags:
        """The flags of a parameter: whether it is differentiable, and whether it moves edges (`Discontinuous`)."""
        return self._entry(key).flags

    def owners(self, key: str) -> Iterator[Plugin]:
        """The plugin that has a parameter, the one that this is nested in, and so on."""
        node: Plugin | None = self._entry(key).owner
        while node is not None:
            yield node
            node = self._parents[id(node)]

    def names_of(self, node: Plugin) -> list[str]:
        """The names of the parameters of one plugin, without those of what is nested in it."""
        return [key for key, entry in self._entries.items() if entry.owner is node]

    def copy(self) -> SceneParameters:
        """A second view of the same parameters, which can be narrowed down with `keep` independently."""
        return SceneParameters(self._root, self._entries, self._parents)

    def _older_name(self, key: str) -> str:
        """The key of the flat array that `key` may be the newer name of."""
        path, dot, name = key.rpartition(".")
        return f"{path}{dot}{NEWER_NAMES.get(name, (name, 0))[0]}"

    def _entry(self, key: str) -> Entry:
        if isinstance(key, str):
            if key in self._entries:
                return self._entries[key]
            older = self._entries.get(self._older_name(key))
            if older is not None:
                columns = NEWER_NAMES[key.rpartition(".")[2]][1]
                return RowsEntry(older.owner, older.name, older.attribute, older.flags, older.path, columns)
        raise ParameterError(f"unknown parameter {key!r}{near_miss(str(key), self._entries)}")

    # ---- narrowing down ------------------------------------------------------------------

    def keep(self, keys: str | Iterable[str] | None = None) -> None:
        """Forget all parameters but those whose names begin with a match of a regular expression.

        Args:
            keys: one pattern or several; None keeps the differentiable parameters.
        """
        if keys is None:
            kept = [key for key, entry in self._entries.items() if entry.flags.differentiable]
        else:
            try:
                patterns = [keys] if isinstance(keys, str) else list(keys)
                matches = [re.compile(pattern).match for pattern in patterns]
            except (re.error, TypeError) as error:
                raise ParameterError(f"keep: {describe(keys)} isn't a regular expression: {error}") from None
            names = {key: key for key in self._entries}
            newer = {older: name for name, (older, _) in NEWER_NAMES.items()}
            for key in self._entries:
                path, dot, name = key.rpartition(".")
                names[f"{path}{dot}{newer.get(name, name)}"] = key
            found = {key for name, key in names.items() if any(match(name) for match in matches)}
            kept = [key for key in self._entries if key in found]
        self._entries = {key: self._entries[key] for key in kept}

    def __delitem__(self, key: str) -> None:
        self._entry(key)
        del self._entries[key if key in self._entries else self._older_name(key)]

    # ---- editing -------------------------------------------------------------------------

    def __setitem__(self, key: str, value: Any) -> None:
        entry = self._entry(key)
        if entry.flags & ParamFlags.ReadOnly:
            raise ParameterError(f"{key}: can't be assigned: it is computed from other parameters")
        current, loan = entry.read(), self._lent.get(key)
        if loan is not None and loan.is_copy and value is loan.value and not loan.is_edited():
            return
        in_place = loan is not None and value is loan.value and not (loan.is_copy or entry.is_computed())
        if not in_place and is_same(value, current):
            return  # checked before: to read it again would wait for all kernels under way
        try:
            converted = convert(entry.owner.check_parameter(entry.name, value), current)
            if not entry.flags.differentiable and dr.grad_enabled(value):
                raise ParameterError("isn't differentiable, but the value has gradients enabled")
        except DjptError as error:
            if in_place and loan is not None:
                # The edit in place has changed the plugin already: undo it.
                entry.write(loan.before)
                del self._lent[key]
            message = str(error)
            raise ParameterError(message if key in message else f"{key}: {message}") from None
        if in_place and loan is not None:
            if loan.is_edited():
                self._dirty.setdefault(key, (entry, loan.before))
            return
        if is_same(converted, current):
            return
        self._dirty.setdefault(key, (entry, current if loan is None or entry.is_computed() else loan.before))
        self._lent.pop(key, None)
        entry.write(converted)

    def set_dirty(self, key: str) -> None:
        """Make the next `update` treat a parameter as changed."""
        entry = self._entry(key)
        self._dirty.setdefault(key, (entry, entry.read()))

    def update(self, values: Mapping[str, Any] | None = None) -> list[tuple[Plugin, set[str]]]:
        """Recompute what depends on the parameters that have changed since the last update.

        Args:
            values: assigned first, if given; keys that aren't parameters are ignored, as in Mitsuba
                (so an optimiser with further variables can be passed).

        Returns:
            The plugins that were updated, nested ones first, each with the names that changed in it.

        Raises:
            ParameterError: a value can't be used. If values contradict each other, all changes since
                the last update are taken back.
        """
        if values is not None:
            if not hasattr(values, "items"):
                raise ParameterError(f"update: expected a mapping of names to values, found {describe(values)}")
            for key, value in values.items():
                if key in self:
                    self[key] = value
        for key, loan in list(self._lent.items()):
            if key in self and loan.is_edited():
                self[key] = loan.value
        self._lent.clear()

        changes, self._dirty = list(self._dirty.values()), {}
        told = self._who_must_know([entry for entry, _ in changes])
        try:
            tell(told)
        except DjptError as error:
            for entry, before in changes:
                entry.write(before)
            tell(told)
            raise ParameterError(str(error)) from None
        refresh = getattr(self._root, "refresh", None)
        if told and refresh is not None:
            edited = {id(entry.owner) for entry, _ in changes}
            with may_wait():
                refresh([node for node, _ in told if id(node) in edited])
        if changes and self._root not in SCENES:
            follow({(id(entry.owner), entry.attribute) for entry, _ in changes})
        return told

    def _who_must_know(self, changed: Iterable[Entry]) -> list[tuple[Plugin, set[str]]]:
        """The owners of changed parameters and all plugins around them, innermost first, with the changed names."""
        found: dict[int, tuple[int, Plugin, set[str]]] = {}
        for entry in changed:
            node: Plugin | None = entry.owner
            names = [*entry.path, entry.name]
            while node is not None:
                _, _, keys = found.setdefault(id(node), (len(names), node, set()))
                keys.add(names.pop())
                node = self._parents[id(node)]
        return [(node, keys) for _, node, keys in sorted(found.values(), key=lambda item: -item[0])]

    @property
    def held(self) -> list[Any]:
        """The names of the parameters, and what functions frozen by `dr.freeze` see of their root."""
        return [Structure(tuple(self._entries)), *self._root.held]

    # ---- display -------------------------------------------------------------------------

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._entries)

    def __repr__(self) -> str:
        if not self._entries:
            return "SceneParameters[]"
        rows = [("Name", "Flags", "Type", "Parent")]
        for key, entry in self._entries.items():
            signs = {"∂": entry.flags.differentiable, "D": entry.flags & ParamFlags.Discontinuous}
            flags = [sign for sign, holds in signs.items() if holds]
            rows.append((key, ", ".join(flags), type(lent(entry.read())).__name__, type(entry.owner).__name__))
        widths = [max(len(row[i]) for row in rows) for i in range(4)]
        lines = ["  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
        rule = "  " + "-" * (sum(widths) + 6)
        return "\n".join(
            ["SceneParameters[", rule, lines[0].rstrip(), rule, *(x.rstrip() for x in lines[1:]), rule, "]"]
        )


def tell(told: Iterable[tuple[Plugin, set[str]]]) -> None:
    """Let plugins recompute what they derive from changed parameters."""
    with may_wait():
        for node, keys in told:
            try:
                node.parameters_changed(sorted(keys))
            except DjptError as error:
                message = str(error)
                raise ParameterError(message if node.id() in message else f"{node.id()}: {message}") from None


def state_of(value: Any) -> Any:
    """A key that differs after any edit: the Dr.Jit and gradient indices of an array, else the value."""
    on_lanes = dr.is_array_v(value) or hasattr(value, "DRJIT_STRUCT")
    return tuple(dr.detail.collect_indices(value)) if on_lanes else value


def is_same(value: Any, current: Any) -> bool:
    """True if two values are of one type and known to be equal, gradients included."""
    if type(value) is not type(current) or (dr.is_tensor_v(value) and value.shape != current.shape):
        return False
    return bool(state_of(value) == state_of(current))


def convert(value: Any, current: Any) -> Any:
    """Convert `value` to the type of `current`, copied if it is an array; raise `SceneError` if it can't be."""
    if dr.is_array_v(current):
        return convert_array(value, current)
    if isinstance(value, AttachedNumber):
        return value
    if isinstance(current, (bool, int, float, str)) and type(value) is not type(current):
        if isinstance(current, float):
            return as_number(value)
        if isinstance(current, int) and not isinstance(current, bool):
            return as_integer(value)
        raise SceneError(f"must be a {type(current).__name__}, found {describe(value)}")
    if isinstance(value, float):
        return as_number(value)
    return value


def convert_array(value: Any, current: Any) -> Any:
    """Convert `value` to a finite array of the type of `current`: a copy, attached to the same gradients.

    Where `current` is uniform (of width 1), the result must be, too.
    """
    target = type(current)
    fixed = not dr.is_tensor_v(target) and dr.size_v(target) > 0
    wanted = f"{dr.size_v(target)} numbers" if fixed else "numbers"
    if dr.is_integral_v(target) and dr.is_array_v(value) and not dr.is_integral_v(value):
        raise SceneError(f"must be integers, found {describe(value)}")
    # Numbers without a shape are those of a tensor in its order, as those of a NumPy array are.
    parts = [value if fixed or dr.is_tensor_v(target) or not dr.is_tensor_v(value) else value.array]
    if not dr.is_array_v(value):
        array = as_array(value)
        if dr.is_integral_v(target) and (array != np.round(array)).any():
            raise SceneError(f"must be integers, found {describe(value)}")
        array = array.astype(np.float32 if dr.is_float_v(target) else np.int64)
        if fixed and array.shape != (dr.size_v(target),):
            raise SceneError(f"must be {wanted}, found {describe(value)}")
        # Memory shared with NumPy may be unaligned, which needs other kernels: single numbers are copied.
        single = array.size == 1 and not dr.is_tensor_v(target)
        copied = array.ravel().tolist() if fixed or single else None
        parts = copied or [array if dr.is_tensor_v(target) else array.ravel()]
    try:
        converted = target(*parts)
    except Exception as error:
        raise SceneError(f"must be {wanted}, found {describe(value)}") from error
    if not dr.is_tensor_v(target) and dr.width(current) == 1 != dr.width(converted):
        raise SceneError(f"must be {wanted}, found {describe(value)}")
    if not recording():
        as_array(dr.detach(converted))  # raises if a number isn't finite
    return converted
