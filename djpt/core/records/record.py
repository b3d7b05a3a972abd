"""The base of records: fields of Dr.Jit arrays that are made when they are first read."""

from __future__ import annotations

import builtins
import sys
import threading
import weakref
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, get_origin

import drjit as dr

from djpt.errors import RenderError
from djpt.jit.types import backend

__all__ = [
    "Record",
    "SceneRef",
    "Wavelengths",
    "assignable",
    "latest_scene_ref",
    "no_wavelengths",
    "note_latest",
    "of_scene",
    "only",
    "optional",
    "scene_of",
]

Wavelengths = backend.Array0f
"""The wavelengths of a record: none, since light is RGB."""


def field_type(kind: Any, known: Mapping[str, Any]) -> Any:
    """The type that an annotation stands for, as a type or as text; `tuple` for ``tuple[Float]``."""
    found = eval(kind.partition("[")[0], {}, known) if isinstance(kind, str) else kind
    return get_origin(found) or found


class Record:
    """A structure of Dr.Jit arrays: it can be loop state, gathered, scattered, selected, zeroed and evaluated.

    The annotations of a class without a value name its fields and their types. A field that isn't given is made when
    it is first read, so a record costs no more than the fields that are used. What is assigned to a field is
    converted to its type: lists and NumPy arrays become vectors, numbers become arrays.

    A field of the type `tuple` holds what may be missing, as an empty tuple or one with a single entry, and one of the
    type `dict` refers to a Python object, as its only key. Dr.Jit carries both through all its operations; it can't
    gather None.
    """

    title: ClassVar[str] = ""
    """The name that `repr` gives, as in Mitsuba; by default the class's own."""

    DRJIT_STRUCT: ClassVar[dict[str, Any]] = {}
    """The types of the fields: Dr.Jit's protocol."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        known = vars(builtins) | vars(sys.modules[cls.__module__])
        fields: dict[str, Any] = {}
        for base in reversed(cls.__mro__):
            fields |= vars(base).get("DRJIT_STRUCT", {})
        # Without `typing.get_type_hints`, which takes twenty times as long.
        fields |= {name: field_type(kind, known) for name, kind in cls.__annotations__.items()}
        cls.DRJIT_STRUCT = {name: kind for name, kind in fields.items() if kind is not ClassVar}

    def __init__(self, other: Record | None = None, **fields: Any) -> None:
        """Copy the fields that `other` has, too, and set those that are given."""
        if other is not None:
            self.assign(other)
        for name, value in fields.items():
            if name not in self.DRJIT_STRUCT and not isinstance(getattr(type(self), name, None), property):
                raise TypeError(
                    f"{type(self).__name__} has no field '{name}'; its fields: {', '.join(self.DRJIT_STRUCT)}"
                )
            setattr(self, name, value)

    @classmethod
    def holding(cls, **fields: Any) -> Any:
        """A record of fields that have their types already: the fast way to make one."""
        record = object.__new__(cls)
        record.__dict__.update(fields)
        return record

    def default(self, name: str) -> Any:
        """The value of a field that wasn't given: zeros, unless the class knows better."""
        kind = self.DRJIT_STRUCT[name]
        return () if kind is tuple else dr.zeros(kind)

    def fill_with_zeros(self, size: int) -> None:
        """Set all fields as `dr.zeros` does: for the `zero_` of classes in which some field is another number."""
        for name, kind in self.DRJIT_STRUCT.items():
            if kind not in (tuple, dict):
                self.__dict__[name] = dr.zeros(kind, size)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name not in type(self).DRJIT_STRUCT:
                why = ": light isn't polarised" if "mueller" in name else ""
                raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'{why}")
            value = self.default(name)
            self.__dict__[name] = value
            return value

    def __setattr__(self, name: str, value: Any) -> None:
        kind = self.DRJIT_STRUCT.get(name)
        if kind is not None and type(value) is not kind and dr.is_array_v(kind):
            value = kind(value)
        object.__setattr__(self, name, value)

    @property
    def wavelengths(self) -> Any:
        """Nothing: light is RGB."""
        return Wavelengths()

    @wavelengths.setter
    def wavelengths(self, wavelengths: Any) -> None:
        no_wavelengths(wavelengths)

    def assign(self, other: Record) -> None:
        """Take over copies of the fields of `other` that this record has, too."""
        for name, value in list(other.__dict__.items()):
            if name in self.DRJIT_STRUCT:
                self.__dict__[name] = dr.copy(value)

    def replaced(self, **fields: Any) -> Any:
        """A record with other values in some of its fields; it shares the others."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        for name, value in fields.items():
            setattr(other, name, value)
        return other

    def __setitem__(self, mask: Any, other: Any) -> None:
        """Take over the lanes of `other` where `mask` is true."""
        self.assign(dr.select(mask, other, self))

    def __repr__(self) -> str:
        lines = [f"  {name}={self.text(name)}" for name in self.shown()]
        return f"{self.title or type(self).__name__}[\n" + ",\n".join(lines) + "\n]"

    def shown(self) -> Sequence[str]:
        """The names that `repr` lists: the fields that are arrays."""
        return [name for name, kind in self.DRJIT_STRUCT.items() if kind not in (tuple, dict)]

    def text(self, name: str) -> str:
        """An entry of `repr`; fields that nobody has read or given are empty."""
        if name in self.DRJIT_STRUCT and name not in self.__dict__:
            return "[]"
        value = getattr(self, name)
        if dr.is_array_v(value) and dr.is_mask_v(value):
            value = dr.select(value, backend.UInt32(1), 0)
        return repr(value).replace("\n", "\n" + " " * (len(name) + 3))


def no_wavelengths(wavelengths: Any) -> None:
    """Raise `RenderError` if a record is given wavelengths: light is RGB."""
    if wavelengths is not None and len(wavelengths):
        raise RenderError(f"light is RGB, so records have no wavelengths: pass [], found {wavelengths!r}")


# ---- the Python object that a record belongs to ----------------------------------------------


SceneRef = dict[Any, tuple[()]]
"""A reference: the only key. Dr.Jit keeps the keys of dicts whatever it does with their values."""


class OfScene:
    """A scene as a key. Loops of Dr.Jit ask all keys for their text, which is long if it is that of a scene."""

    def __init__(self, scene: Any) -> None:
        self.scene = scene

    def __hash__(self) -> int:
        return id(self.scene)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, OfScene) and other.scene is self.scene

    def __repr__(self) -> str:
        return "scene"


def of_scene(scene: Any) -> SceneRef:
    """A reference to a scene."""
    return {OfScene(scene): ()}


class Latest(threading.local):
    """The scene that a thread has loaded, rendered or asked for hits last, if it still exists.

    Records that a script makes by `dr.zeros` belong to it. They have to belong to one from the beginning: a loop of
    Dr.Jit makes its results of the state that it began with, keys of dicts included, and doesn't look at the keys of
    what the body returns. A record that began without a scene would lose that of the hits found in the loop.
    """

    scene: weakref.ref[Any] | None = None


_latest = Latest()


def note_latest(scene: Any) -> None:
    """Make `scene` the one that records made by `dr.zeros` in this thread belong to."""
    _latest.scene = weakref.ref(scene)


def latest_scene_ref() -> SceneRef:
    """The scene of records made by `dr.zeros`, so that they fit into loops and selects with those of hits."""
    scene = None if _latest.scene is None else _latest.scene()
    return {} if scene is None else of_scene(scene)


def scene_of(record: Any) -> Any:
    """The scene that a record belongs to; raise `RenderError` if there is none."""
    for key in record.scene_ref:
        return key.scene
    raise RenderError(f"this {type(record).__name__} belongs to no scene: it wasn't found by a ray")


def only(entries: tuple[Any, ...]) -> Any:
    """The entry of a field that may be missing, or None."""
    return entries[0] if entries else None


def optional(entries: str, doc: str) -> Any:
    """A property for the entry of a field that may be missing: None if the tuple `entries` is empty."""

    def get(self: Any) -> Any:
        return only(getattr(self, entries))

    def set_(self: Any, value: Any) -> None:
        setattr(self, entries, () if value is None else (value,))

    return property(get, set_, doc=doc)


def assignable(name: str, find: Callable[[Any], Any], doc: str) -> Any:
    """A property that is found out unless it was assigned; what was assigned Dr.Jit's operations don't carry along."""
    key = f"_{name}"

    def get(self: Any) -> Any:
        return self.__dict__[key] if key in self.__dict__ else find(self)

    def set_(self: Any, value: Any) -> None:
        self.__dict__[key] = value

    return property(get, set_, doc=doc)
