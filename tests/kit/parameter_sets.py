"""Sets of parameters as test parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest

__all__ = ["slow_but_first"]


def slow_but_first(names: Iterable[str], plugin_of: Callable[[str], str], long: Iterable[str] = ()) -> list[Any]:
    """Parameter sets as test parameters: slow but for the first of each plugin, and for all of the plugins `long`."""
    seen = set(long)
    result = []
    for name in names:
        slow = plugin_of(name) in seen
        seen.add(plugin_of(name))
        result.append(pytest.param(name, id=name, marks=pytest.mark.slow if slow else ()))
    return result
