"""Each public name of Mitsuba beside djpt's."""

from __future__ import annotations

import dataclasses
import dis
import enum
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from types import FunctionType, ModuleType
from typing import Any

from djpt.mitsuba.exclusions import reason
from djpt.validation.names.signatures import refused_call, signatures
from djpt.validation.names.walk import PublicName, public_names

__all__ = ["Finding", "Verdict", "findings"]

MISSING: Any = object()


class Verdict(enum.Enum):
    """The result for a name."""

    HERE = "here"
    DIFFERENT = "different"
    EXCLUDED = "left out"
    ABSENT = "absent"


@dataclass(frozen=True)
class Finding:
    """A public name of Mitsuba, and what djpt has."""

    name: PublicName
    verdict: Verdict
    note: str = ""
    """The difference, or the reason to leave the name out."""


def findings(mitsuba: ModuleType, djpt: Any) -> list[Finding]:
    """Compare all public names of `mitsuba` with those of `djpt`.

    A name that is here is here, also if there is a reason to leave it out.
    """
    return [finding(name, djpt) for name in public_names(mitsuba)]


def finding(name: PublicName, djpt: Any) -> Finding:
    """Compare one name."""
    found = look_up(djpt, name.path)
    why = reason(name.path)
    if found is MISSING:
        return Finding(name, Verdict.EXCLUDED, why) if why else Finding(name, Verdict.ABSENT)
    problem = COMPARE[name.kind](name, found)
    if problem is None:
        return Finding(name, Verdict.HERE)
    return Finding(name, Verdict.EXCLUDED, why) if why else Finding(name, Verdict.DIFFERENT, problem)


@dataclass(frozen=True)
class Field:
    """An attribute that only the objects of a class have."""

    name: str


@dataclass(frozen=True)
class Method:
    """A method as a class has it."""

    cls: type
    value: Any
    """The attribute as `getattr` returns it."""
    static: Any
    """The attribute as the class stores it."""


def look_up(root: Any, path: str) -> Any:
    """The object that a dotted path leads to, or `MISSING`."""
    value = root
    for part in path.split("."):
        if inspect.isclass(value):
            value = member(value, part)
        else:
            try:
                value = getattr(value, part)
            except Exception:  # names that are refused on purpose raise what the script shall see
                return MISSING
        if value is MISSING:
            return MISSING
    return value


def member(cls: type, name: str) -> Any:
    """The attribute that the objects of a class have under a name."""
    static = inspect.getattr_static(cls, name, MISSING)
    if static is not MISSING:
        value = getattr(cls, name)
        if inspect.isclass(value) or isinstance(value, (property, enum.Enum)) or not callable(value):
            return value
        return Method(cls, value, static)
    return Field(name) if name in fields(cls) else MISSING


def fields(cls: type) -> set[str]:
    """The attributes that objects of a class get: fields, annotations, assignments in ``__init__``."""
    names = {f.name for f in dataclasses.fields(cls)} if dataclasses.is_dataclass(cls) else set()
    for base in cls.__mro__:
        names.update(vars(base).get("__annotations__", {}))
        constructor = vars(base).get("__init__")
        if isinstance(constructor, FunctionType):
            names.update(i.argval for i in dis.get_instructions(constructor) if i.opname == "STORE_ATTR")
    return names


def compare_class(name: PublicName, ours: Any) -> str | None:
    """Compare the constructors of two classes."""
    if not inspect.isclass(ours):
        return None if callable(ours) else "no class"
    constructor = vars(name.value).get("__init__")
    if not (isinstance(constructor, FunctionType) or hasattr(constructor, "__nb_signature__")):
        return None  # inherited, or no objects of it can be made
    return refusal(signatures(constructor, bound=True), signatures(ours, bound=False))


def compare_array_type(name: PublicName, ours: Any) -> str | None:
    """Compare the element type and the size of two types of arrays; other classes of Dr.Jit may be derived from."""
    import drjit as dr

    if ours is name.value or (inspect.isclass(ours) and issubclass(ours, name.value)):
        return None
    if not (inspect.isclass(ours) and dr.is_array_v(ours) and dr.is_array_v(name.value)):
        return f"another type: {getattr(ours, '__name__', ours)}"
    traits: list[Callable[[Any], Any]] = [dr.type_v, dr.size_v, dr.depth_v, dr.is_matrix_v, dr.is_tensor_v, dr.is_jit_v]
    return None if all(f(ours) == f(name.value) for f in traits) else f"another type: {ours.__name__}"


def compare_function(name: PublicName, ours: Any) -> str | None:
    """Compare the calls that two functions allow."""
    if not callable(ours):
        return "not a function"
    return refusal(signatures(name.value, bound=False), signatures(ours, bound=False))


def compare_method(name: PublicName, ours: Any) -> str | None:
    """Compare the calls that two methods allow."""
    if not isinstance(ours, Method):
        return "an attribute, not a method"
    static = isinstance(name.value, (staticmethod, classmethod)) or type(name.value).__name__ == "nb_func"
    value = name.value.__func__ if isinstance(name.value, (staticmethod, classmethod)) else name.value
    theirs = signatures(value, bound=isinstance(name.value, classmethod) or not static)
    plain = isinstance(ours.static, FunctionType) or hasattr(ours.static, "__nb_signature__")
    if static and plain:
        return "needs an object of the class"
    return refusal(theirs, signatures(ours.value, bound=plain))


def compare_property(name: PublicName, ours: Any) -> str | None:
    """An attribute stays an attribute."""
    return "a method, not an attribute" if isinstance(ours, Method) else None


def compare_constant(name: PublicName, ours: Any) -> str | None:
    """Compare two values."""
    if isinstance(ours, (Method, Field, property)) or ours != name.value:
        return f"another value: {ours!r}"
    return None


def compare_member(name: PublicName, ours: Any) -> str | None:
    """Compare the numbers of two members of enumerations."""
    number = getattr(ours, "value", ours)
    return None if number == name.value.value else f"another value: {number!r}"


def compare_module(name: PublicName, ours: Any) -> str | None:
    """Modules are compared name by name."""
    return None


def refusal(theirs: list[inspect.Signature], ours: list[inspect.Signature]) -> str | None:
    """Say which call is refused."""
    if not theirs:
        return None
    if not ours:
        return "no readable signature"
    call = refused_call(theirs, ours)
    return f"refuses {call}" if call else None


COMPARE: dict[str, Callable[[PublicName, Any], str | None]] = {
    "module": compare_module,
    "class": compare_class,
    "array type": compare_array_type,
    "function": compare_function,
    "method": compare_method,
    "property": compare_property,
    "constant": compare_constant,
    "member": compare_member,
}
