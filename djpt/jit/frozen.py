"""Objects as functions frozen by `dr.freeze` see them, and whether one of these is being recorded.

A frozen function launches the kernels of an earlier call again, with new arrays. It must therefore be told all arrays
that its kernels read, and everything else that shaped them. Dr.Jit looks for a `DRJIT_STRUCT`; here it finds one
whose single field lists what can be reached from the object: first, as one hashable value, all that isn't an array
of Dr.Jit, which is structure; then the arrays. Arrays may have other values in the next call, structure may not:
where it differs the function is traced again.
"""

from __future__ import annotations

import gc
import inspect
import operator
import types
import warnings
import weakref
from collections.abc import Collection, Hashable, Iterable
from enum import Enum
from functools import cache, partial
from itertools import chain
from typing import Any

import drjit as dr
import numpy as np

from djpt.errors import ParameterError

__all__ = [
    "SHARED",
    "Held",
    "Holder",
    "Structure",
    "hold_garbage",
    "recording",
    "require_editable",
    "undifferentiated",
]

SHARED: list[Any] = []
"""Arrays that kernels may read whatever they compute: they belong to the process, not to a scene."""

Container = list[Any] | dict[Any, Any]

PLAIN = (bool, int, float, complex, str, bytes, type(None), type, Enum, np.generic)

SMALL = 64
"""Arrays of NumPy up to this size are compared by their numbers, larger ones by identity."""


def recording() -> bool:
    """True if `dr.freeze` records what is computed now, to repeat it with other arrays.

    Arrays can't be read on the host then, nor be made of memory that Dr.Jit doesn't own.
    """
    return bool(dr.flag(dr.JitFlag.FreezingScope))


def hold_garbage() -> None:
    """Let Python collect no garbage while a function is recorded, and again afterwards; called at both times.

    Among the garbage may be arrays that share NumPy's memory, and a process that releases one of these while
    Dr.Jit 1.5 records is ended.
    """
    if recording() and gc.isenabled():
        gc.disable()
        _held.append(True)
    elif _held and not recording():
        _held.clear()
        gc.enable()


_held: list[bool] = []
"""Not empty while collections are off because of `hold_garbage`; as these, for the whole process."""


undifferentiated: list[str] = []
"""Names of images that a frozen function has rendered with gradients, and not differentiated since.

Dr.Jit records one function at a time, and tells nobody when it is done: the next call of djpt looks here."""


def warn_of_lost_gradients() -> None:
    """Warn if a function that was recorded returns images without having differentiated them."""
    if undifferentiated and not recording():
        undifferentiated.clear()
        warnings.warn(
            "a function frozen by dr.freeze has rendered an image with gradients without differentiating it: "
            "its result has none, so call dr.backward or dr.forward in the function",
            stacklevel=2,
        )


def require_editable(plugins: Iterable[Any]) -> None:
    """Raise `ParameterError` if an edit of some plugins can't be part of a frozen function that is recorded now."""
    for plugin in plugins:
        if plugin.kind in ("shape", "sensor") and recording():
            raise ParameterError(
                f"{plugin.id()}: {plugin.kind}s can't be edited while dr.freeze records a function, "
                "since the host computes what follows: call update() before the function"
            )


class Structure:
    """A hashable value; not a tuple, since Dr.Jit would look for arrays in it."""

    __slots__ = ("parts",)

    def __init__(self, parts: tuple[Hashable, ...]) -> None:
        self.parts = parts

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Structure) and self.parts == other.parts

    def __hash__(self) -> int:
        return hash(self.parts)


class Same:
    """A hashable value that stands for one object, and keeps it alive."""

    __slots__ = ("what",)

    def __init__(self, what: Any) -> None:
        self.what = what

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self.what is other.what

    def __hash__(self) -> int:
        return id(self.what)


class Inventory:
    """The arrays and the structure that can be reached from an object."""

    def __init__(self, root: Any) -> None:
        self._root = weakref.ref(root)
        self._parts: list[Any] = [self._root]
        self._arrays: list[Any] = []
        self._visited: dict[int, tuple[int, Any]] = {}
        self._contents: list[Collection[Any]] = []
        self._noted: list[tuple[Any, ...]] = []
        self._visit_members(root)
        self._shared = len(SHARED)
        self.list = [Structure(tuple(self._parts)), *self._arrays, *SHARED]
        """The structure, and the arrays in an order that depends on the structure alone."""
        self._lengths = [len(values) for values in self._noted]
        self._values = list(chain.from_iterable(self._noted))
        del self._parts, self._arrays, self._visited, self._noted

    def is_current(self, root: Any) -> bool:
        """True if everything is still where it was; arrays may have been changed in place."""
        # Thousands of values in hundreds of lists and dicts, several times per call: no line of Python for each.
        return (
            self._root() is root
            and self._shared == len(SHARED)
            and list(map(len, self._contents)) == self._lengths
            and all(map(operator.is_, chain.from_iterable(self._contents), self._values))
        )

    def _visit(self, value: Any) -> None:
        kind: Any = type(value)
        sort = sort_of(kind)
        if sort == "plain":
            self._parts.append(value)
        elif kind is tuple and not value:
            self._parts.append(kind)
        elif sort == "input" and dr.width(value):
            self._arrays.append(value)
        elif sort:
            self._parts.append(repr(value))
        elif id(value) in self._visited:
            self._parts.append(self._visited[id(value)][0])
        else:
            # The object is kept beside its number so that its id stays taken.
            self._visited[id(value)] = (len(self._visited), value)
            self._parts.append(kind)
            self._visit_members(value)

    def _visit_members(self, value: Any) -> None:
        """Visit what an object consists of, in an order that it keeps."""
        if isinstance(value, np.ndarray):
            small = value.size <= SMALL and value.dtype != object
            self._parts.append((value.shape, value.tobytes()) if small else Same(value))
        elif isinstance(value, (frozenset, set)):
            self._parts.append(frozenset(entry for entry in value if isinstance(entry, PLAIN)))
        elif isinstance(value, tuple):
            self._visit_all(value)
        elif isinstance(value, list):
            self._visit_all(self._note(value))
        elif isinstance(value, dict):
            # Keys with identities tell entries apart that were made anew, in another order.
            self._parts.extend(key if isinstance(key, (str, int, tuple)) else type(key) for key in value)
            self._visit_all(self._note(value))
        else:
            self._visit_all(members(value))
            own = getattr(value, "__dict__", None)
            if isinstance(own, dict) and not isinstance(value, types.ModuleType):
                self._parts.extend(own)
                self._visit_all(self._note(own))

    def _visit_all(self, values: tuple[Any, ...]) -> None:
        self._parts.append(len(values))
        for value in values:
            self._visit(value)

    def _note(self, holder: Container) -> tuple[Any, ...]:
        """The values in a list or dict, as they are now."""
        # The values of a dict are a view, which shows later ones as well.
        contents = holder.values() if isinstance(holder, dict) else holder
        values = tuple(contents)
        self._contents.append(contents)
        self._noted.append(values)
        return values


@cache
def sort_of(kind: Any) -> str:
    """The use of a type's objects: ``plain``, ``input`` (arrays of kernels), ``array`` (others), or none of them."""
    if issubclass(kind, PLAIN):
        return "plain"
    if not dr.is_array_v(kind):
        return ""
    return "input" if dr.is_jit_v(kind) else "array"


def members(value: Any) -> tuple[Any, ...]:
    """The objects that an object refers to besides its attributes."""
    if isinstance(value, types.FunctionType):
        return tuple(inspect.getclosurevars(value).nonlocals.values()) if value.__closure__ else ()
    if isinstance(value, types.MethodType):
        return value.__self__, value.__func__
    if isinstance(value, partial):
        return value.func, value.args, value.keywords
    kind: Any = type(value)
    return tuple(getattr(value, name) for name in slots_of(kind) if hasattr(value, name))


@cache
def slots_of(kind: Any) -> tuple[str, ...]:
    """The names of the slots that say something of a type's objects."""
    slots = [name for base in kind.__mro__ for name in getattr(base, "__slots__", ())]
    return tuple(name for name in slots if name not in UNSEEN)


UNSEEN = ("__weakref__", "_inventory")
"""Slots that say nothing of an object."""


class Held:
    """The attribute `DRJIT_STRUCT` of objects that only frozen functions look into.

    Anywhere else Dr.Jit treats them as it treats Python's own objects: it carries them along.
    """

    def __get__(self, holder: Any, owner: type) -> dict[str, type]:
        if not dr.flag(dr.JitFlag.EnableObjectTraversal):
            raise AttributeError("DRJIT_STRUCT")
        return {"held": list}


class Holder:
    """An object that tells frozen functions what it holds."""

    # A slot, since the attributes of plugins may be inputs of kernels, and copies share them.
    __slots__ = ("_inventory",)
    DRJIT_STRUCT = Held()

    def prepare_to_record(self) -> None:
        """Make what can't be made while a frozen function is recorded."""

    @property
    def held(self) -> list[Any]:
        """The structure of the object, and the arrays that can be reached from it: see `Inventory`."""
        hold_garbage()
        warn_of_lost_gradients()
        found: Inventory | None = getattr(self, "_inventory", None)
        if found is None or not found.is_current(self):
            self.prepare_to_record()
            found = self._inventory = Inventory(self)
        return list(found.list)

    def disable_grad(self) -> None:
        """Detach the arrays that `held` listed last."""
        dr.disable_grad(self._inventory.list[1:])
