"""The public names of Mitsuba's Python module."""

from __future__ import annotations

import enum
import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

__all__ = ["PublicName", "public_names"]

LEFT_OUT = {"python", "testing", "test", "llvm_ad_rgb", "mitsuba_alias", "mitsuba_ext", "casters", "cast_object"}
"""Other paths to the same names, and what belongs to Mitsuba's own tests and binary modules."""


@dataclass(frozen=True)
class PublicName:
    """One name, such as ``Ray3f``, ``Ray3f.o`` or ``warp.square_to_tent``."""

    path: str
    value: Any
    kind: str
    """``module``, ``class``, ``array type``, ``method``, ``property``, ``member`` of an enumeration, ``function`` or
    ``constant``."""

    @property
    def owner(self) -> str:
        """The class or module that the name belongs to; empty for Mitsuba itself."""
        return self.path.rpartition(".")[0]


def public_names(mitsuba: ModuleType) -> list[PublicName]:
    """All public names of Mitsuba in the variant that is set, each once.

    A name that a class inherits belongs to its base; an object with several names is entered at the first.
    Operators (``__add__``) aren't counted; constructors are part of their class.
    """
    return list(in_module(mitsuba, "", set()))


def in_module(module: ModuleType, prefix: str, seen: set[int]) -> Iterator[PublicName]:
    """The names of a module and of all in it; what a file of Python imports from another isn't its own."""
    seen.add(id(module))
    imports_count = not str(getattr(module, "__file__", "")).endswith(".py") or hasattr(module, "__path__")
    for name in sorted(dir(module)):
        if name.startswith("_") or name in LEFT_OUT:
            continue
        value, path = getattr(module, name), f"{prefix}{name}"
        if isinstance(value, ModuleType):
            if value.__name__.startswith("mitsuba.") and id(value) not in seen:
                yield PublicName(path, value, "module")
                yield from in_module(value, f"{path}.", seen)
        elif not imports_count and getattr(value, "__module__", module.__name__) != module.__name__:
            continue
        elif inspect.isclass(value):
            if is_theirs(value):
                yield from in_class(value, path, seen)
        elif callable(value):
            if is_theirs(value):
                yield PublicName(path, value, "function")
        elif isinstance(value, (bool, int, float, str)):
            yield PublicName(path, value, "constant")


def is_theirs(value: Any) -> bool:
    """True if an object is Mitsuba's or Dr.Jit's, or a type of numbers, and not an import from elsewhere."""
    home = str(getattr(value, "__module__", "") or "")
    return home.split(".")[0] in ("mitsuba", "drjit", "") or (home == "builtins" and inspect.isclass(value))


def in_class(cls: type, path: str, seen: set[int]) -> Iterator[PublicName]:
    """A class and what is defined in it."""
    own = not cls.__module__.startswith(("drjit", "builtins"))
    yield PublicName(path, cls, "class" if own and not is_array(cls) else "array type")
    if not own or id(cls) in seen:
        return
    seen.add(id(cls))
    if issubclass(cls, enum.Enum):
        for name, member in cls.__members__.items():
            yield PublicName(f"{path}.{name}", member, "member")
        return
    for name in sorted(vars(cls)):
        if name.startswith("_") or name in ("DRJIT_STRUCT", "Domain", "Variant"):
            continue
        value = vars(cls)[name]
        if inspect.isclass(value):
            yield from in_class(value, f"{path}.{name}", seen)
        elif hasattr(value, "original_method"):  # callable on the class and on an object
            yield PublicName(f"{path}.{name}", value.original_method, "method")
        elif callable(value) or isinstance(value, (staticmethod, classmethod)):
            yield PublicName(f"{path}.{name}", value, "method")
        elif isinstance(value, property):
            yield PublicName(f"{path}.{name}", value, "property")
        elif isinstance(value, (bool, int, float, str)):
            yield PublicName(f"{path}.{name}", value, "constant")
        elif isinstance(value, enum.Enum):
            continue  # a member of a nested enumeration, exported to the class


def is_array(cls: type) -> bool:
    """True if a class is a Dr.Jit array of numbers, as opposed to one of pointers."""
    import drjit as dr

    return issubclass(cls, dr.ArrayBase) and not any(hasattr(v, "__nb_signature__") for v in vars(cls).values())
