"""Plugins and scripts: djpt's methods are asked with lists, and scripts' methods answer with Python's numbers."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import drjit as dr

from djpt.jit.types import Bool, Vector3f, converting

__all__ = ["accept_scripts"]


def accept_scripts(cls: type, results: Mapping[str, Callable[[Any], Any]]) -> None:
    """Adapt the methods that a class of plugins defines, for `__init_subclass__` of its kind's base.

    djpt's own methods take whatever their arguments can be made from. Those of scripts get copies of their arguments,
    and what they return gets the types of the contract.

    Args:
        cls: the new class.
        results: the conversion of what each method returns, by name.
    """
    ours = cls.__module__.startswith("djpt.")
    for name, convert in results.items():
        if name in vars(cls):
            method = vars(cls)[name]
            setattr(cls, name, converting(method) if ours else of_script(method, convert))


def of_script(method: Callable[..., Any], convert: Callable[[Any], Any]) -> Callable[..., Any]:
    """Wrap a script's method: results get the types of the contract, arguments are copies.

    Scripts write ``active &= ...``, which changes the array that they were given.
    """

    @functools.wraps(method)
    def wrapper(self: Any, *args: Any, **options: Any) -> Any:
        own = {name: own_copy(x) for name, x in options.items()}
        return convert(method(self, *map(own_copy, args), **own))

    return wrapper


def own_copy(x: Any) -> Any:
    """A copy of an argument, which a script may edit in place."""
    if isinstance(x, bool):
        return Bool(x)
    if hasattr(x, "wi"):  # an interaction
        return x.replaced(wi=Vector3f(x.wi))
    return type(x)(x) if dr.is_array_v(x) else x
