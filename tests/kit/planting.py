"""Faults planted in djpt's own code: a function with one piece of its text replaced."""

from __future__ import annotations
import __future__

import contextlib
import importlib
import inspect
import textwrap
from collections.abc import Iterator

__all__ = ["planted"]


@contextlib.contextmanager
def planted(target: str, old: str, new: str) -> Iterator[None]:
    """Replace ``old`` in the source of a function for a while.

    `target` is ``module:function`` or ``module:Class.method``; the text must be there once, so that a fault can't
    silently become none when the code changes.
    """
    module_name, _, path = target.partition(":")
    module = importlib.import_module(module_name)
    holder_path, _, name = path.rpartition(".")
    holder = getattr(module, holder_path) if holder_path else module
    function = getattr(holder, name)
    source = textwrap.dedent(inspect.getsource(function))
    assert source.count(old) == 1, f"{target}: {old!r} is there {source.count(old)} times"
    code = compile(source.replace(old, new), f"<{target}, changed>", "exec", __future__.annotations.compiler_flag)
    names = dict(inspect.unwrap(function).__globals__)
    exec(code, names)
    setattr(holder, name, names[name])
    try:
        yield
    finally:
        setattr(holder, name, function)
