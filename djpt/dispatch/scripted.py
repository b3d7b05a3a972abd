"""Leniency of plugins: methods take lists and numbers, may edit their arguments, and may return Python's numbers."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any

import drjit as dr

from djpt.core.records import Record
from djpt.jit.types import Bool, Vector3f, argument_types, converted

__all__ = ["accept_scripts"]


def accept_scripts(cls: type, base: type, results: Mapping[str, Callable[[Any], Any]]) -> None:
    """Adapt the methods that a class of plugins defines, for `__init_subclass__` of its kind's base.

    All classes are treated alike, wherever they stand. Arguments may be anything that the types in the base's
    signatures can be made from. Methods get copies of them, since scripts write ``active &= ...``, which changes the
    array that they were given. What they return gets the types of the contract.

    Args:
        cls: The new class.
        base: The base of its kind, which defines all these methods.
        results: The conversion of what each method returns, by name.
    """
    for name, convert in results.items():
        if name in vars(cls):
            setattr(cls, name, lenient(vars(cls)[name], getattr(base, name), convert))


def lenient(method: Callable[..., Any], contract: Callable[..., Any], convert: Callable[[Any], Any]) -> Any:
    """Wrap a method: see `accept_scripts`.

    Args:
        method: The method of a class.
        contract: The method of the kind's base, whose annotations say what arguments are converted to.
        convert: The conversion of the result.
    """
    types = argument_types(contract)
    by_position = [(name, types.get(name)) for name in inspect.signature(contract).parameters][1:]

    def own_copy(name: str, x: Any, kind: Any) -> Any:
        if kind is not None:
            return kind(x) if type(x) is kind else converted(method, name, x, kind)
        if isinstance(x, Record):
            return with_own_wi(x)
        if isinstance(x, bool):
            return Bool(x)
        return type(x)(x) if dr.is_array_v(x) else x

    @functools.wraps(method)
    def wrapper(self: Any, *args: Any, **options: Any) -> Any:
        pairs = zip(by_position, args, strict=False)
        own = [kind(x) if type(x) is kind else own_copy(name, x, kind) for (name, kind), x in pairs]
        if not options:
            return convert(method(self, *own, *args[len(own) :]))
        named = {name: own_copy(name, x, types.get(name)) for name, x in options.items()}
        return convert(method(self, *own, *args[len(own) :], **named))

    return wrapper


def with_own_wi(record: Any) -> Any:
    """A record that shares all fields but `wi`, which scripts turn around; itself if it has none."""
    if "wi" not in record.DRJIT_STRUCT:
        return record
    other = object.__new__(type(record))
    other.__dict__.update(record.__dict__)
    other.__dict__["wi"] = Vector3f(record.wi)
    return other
