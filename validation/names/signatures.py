"""The calls that a function allows, compared with those of another function."""

from __future__ import annotations

import ast
import inspect
import re
import sys
import typing
from collections.abc import Iterator
from inspect import Parameter, Signature
from types import FunctionType, MethodType
from typing import Any

__all__ = ["refused_call", "signatures"]

UNNAMED = re.compile(r"(arg\d*|other)$")
"""Parameters that nobody names: nanobind's names for those without one, and the original of a copy."""


def signatures(function: Any, *, bound: bool) -> list[Signature]:
    """The overloads of a function, without the parameter that holds the object of a method.

    Read from nanobind's records, from ``typing.overload`` (Python 3.11 and newer) or from the function itself;
    empty if there is nothing to read.

    Args:
        function: anything that can be called.
        bound: whether the first parameter is the object, to be left out.
    """
    if inspect.isclass(function) and (overloads := declared_overloads(function.__init__)):
        return [without_first(s) for s in overloads]
    records = getattr(function, "__nb_signature__", None)
    if isinstance(records, tuple):
        found = [parse(record[0]) for record in records]
    elif overloads := declared_overloads(function):
        found = overloads
    else:
        try:
            found = [inspect.signature(function)]
        except (TypeError, ValueError):
            return []
    return [without_first(s) for s in found] if bound else found


def declared_overloads(function: Any) -> list[Signature]:
    """The forms that a function declares: by `djpt.core.forms`, or by ``typing.overload`` (Python 3.11 on)."""
    forms: list[Signature] | None = getattr(function, "__signatures__", None)
    if forms is not None:
        return forms
    if sys.version_info < (3, 11) or not isinstance(function, (FunctionType, MethodType)):
        return []
    return [inspect.signature(overload) for overload in typing.get_overloads(function)]


def parse(text: str) -> Signature:
    """The signature that a record of nanobind's gives as a line of Python; types are dropped, defaults are `None`."""
    text = re.sub(r"\\\d+", "None", text.strip())
    while (shorter := re.sub(r"\[[^\[\]]*\]", "", text)) != text:
        text = shorter
    try:
        definition = ast.parse(f"{text}: ...").body[0]
    except SyntaxError:
        raise ValueError(f"unreadable signature: {text}") from None
    if not isinstance(definition, ast.FunctionDef):
        raise ValueError(f"not a function: {text}")
    return Signature(list(parameters(definition.args)))


def parameters(found: ast.arguments) -> Iterator[Parameter]:
    """The parameters of a parsed definition, in order."""
    positional = [*found.posonlyargs, *found.args]
    required = len(positional) - len(found.defaults)
    last_unnamed = max((i for i, argument in enumerate(positional) if UNNAMED.match(argument.arg)), default=-1)
    unnamed = max(len(found.posonlyargs), last_unnamed + 1)
    for index, argument in enumerate(positional):
        kind = Parameter.POSITIONAL_ONLY if index < unnamed else Parameter.POSITIONAL_OR_KEYWORD
        yield Parameter(argument.arg, kind, default=None if index >= required else Parameter.empty)
    if found.vararg:
        yield Parameter(found.vararg.arg, Parameter.VAR_POSITIONAL)
    for argument, default in zip(found.kwonlyargs, found.kw_defaults, strict=True):
        yield Parameter(argument.arg, Parameter.KEYWORD_ONLY, default=None if default else Parameter.empty)
    if found.kwarg:
        yield Parameter(found.kwarg.arg, Parameter.VAR_KEYWORD)


def without_first(signature: Signature) -> Signature:
    """The signature of a bound method."""
    found = list(signature.parameters.values())
    takes_all = found and found[0].kind is Parameter.VAR_POSITIONAL
    return signature if takes_all else signature.replace(parameters=found[1:])


def refused_call(theirs: list[Signature], ours: list[Signature]) -> str | None:
    """The first call that one of `theirs` allows and none of `ours` does, as text; None if there is none.

    Every overload is called with its required arguments and with all, by position and by name. A name that
    only falls into ``**kwargs`` counts as refused: that function would take any misspelling, too.
    """
    for signature in theirs:
        for positional, named in calls(signature):
            if not any(accepts(s, positional, named) for s in ours):
                return "(" + ", ".join([*positional, *(f"{name}=" for name in named)]) + ")"
    return None


def calls(signature: Signature) -> Iterator[tuple[list[str], list[str]]]:
    """The calls to try: names of arguments by position, and names of arguments by name."""
    variadic = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
    found = [p for p in signature.parameters.values() if p.kind not in variadic]
    required = [p for p in found if p.default is Parameter.empty]
    for chosen in [required, found] if len(required) < len(found) else [found]:
        by_position = [p.name for p in chosen if p.kind is not Parameter.KEYWORD_ONLY]
        only_named = [p.name for p in chosen if p.kind is Parameter.KEYWORD_ONLY]
        yield by_position, only_named
        unnamed = [p.name for p in chosen if p.kind is Parameter.POSITIONAL_ONLY]
        if len(unnamed) < len(by_position):
            yield unnamed, [p.name for p in chosen if p.name not in unnamed]


def accepts(signature: Signature, positional: list[str], named: list[str]) -> bool:
    """True if a call binds, with each name to a parameter of that name."""
    known = {
        p.name
        for p in signature.parameters.values()
        if p.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)
    }
    if not set(named) <= known:
        return False
    try:
        signature.bind(*positional, **dict.fromkeys(named))
    except TypeError:
        return False
    return True
