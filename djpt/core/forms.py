"""Functions that are called with one of several lists of arguments, and methods that get and set an attribute."""

from __future__ import annotations

import functools
from collections.abc import Callable
from inspect import Parameter, Signature
from typing import Any, TypeVar

from djpt.errors import ArgumentError

__all__ = ["accessors", "forms"]

Function = TypeVar("Function", bound=Callable[..., Any])


def forms(*lists: str) -> Callable[[Function], Function]:
    """Let a function or method that takes keywords be called by position in each of these forms.

    A form is a list of parameters, "nodes values x"; those after a bar may be left out, "nodes values | eps". The form
    that is meant is the first one that has room for the arguments and all keywords of the call.

    Raises:
        ArgumentError: by the function, if no form fits.
    """
    known = [tuple(part.split() for part in f"{text}|".split("|")[:2]) for text in lists]

    def decorate(function: Function) -> Function:
        method = function.__code__.co_varnames[:1] == ("self",)

        @functools.wraps(function)
        def call(*arguments: Any, **keywords: Any) -> Any:
            bound, given = arguments[: int(method)], arguments[int(method) :]
            for needed, optional in known:
                names = [*needed, *optional]
                by_name = dict(zip(names, given, strict=False))
                if len(given) > len(names) or by_name.keys() & keywords.keys():
                    continue
                every = by_name | keywords
                if set(needed) <= every.keys() <= set(names):
                    return function(*bound, **every)
            calls = " or ".join(f"({', '.join(needed + optional)})" for needed, optional in known)
            raise ArgumentError(f"{function.__qualname__}() takes {calls}; found {len(given)} arguments {[*keywords]}")

        call.__signatures__ = [signature(needed, optional, method) for needed, optional in known]  # type: ignore[attr-defined]
        return call  # type: ignore[return-value]

    return decorate


def signature(needed: list[str], optional: list[str], method: bool) -> Signature:
    """The signature of one form, for `djpt.validation.names` and other readers."""
    kind = Parameter.POSITIONAL_OR_KEYWORD
    own = [Parameter("self", kind)] if method else []
    return Signature(
        [*own, *(Parameter(name, kind) for name in needed), *(Parameter(name, kind, default=None) for name in optional)]
    )


def accessors(
    attribute: str, doc: str, convert: Callable[[Any], Any] = bool
) -> tuple[Callable[..., Any], Callable[..., None]]:
    """The methods that return and that set an attribute, as Mitsuba's classes have them in place of properties."""

    def get(self: Any) -> Any:
        return getattr(self, attribute)

    def set_(self: Any, value: Any) -> None:
        setattr(self, attribute, convert(value))

    get.__doc__, set_.__doc__ = doc, f"Set the value: {doc[0].lower()}{doc[1:]}"
    return get, set_
