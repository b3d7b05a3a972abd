"""The requested way of tracing rays and adding to films: calls of compiled functions, or kernels alone.

`djpt.geometry.engines` says what the names mean for rays.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from djpt.errors import SceneError, near_miss

__all__ = ["NAMES", "VARIABLE", "asked_for", "ray_queries"]

NAMES = ("auto", "rings", "call", "steps")

VARIABLE = "DJPT_RAY_QUERIES"
"""The environment variable for one of `NAMES`."""

_forced: ContextVar[str | None] = ContextVar("ray_queries", default=None)


@contextmanager
def ray_queries(name: str) -> Iterator[None]:
    """Let scenes that are loaded inside trace rays in one of the ways `auto`, `rings`, `call`, `steps`.

    Raises:
        SceneError: Another name.
    """
    token = _forced.set(checked(name))
    try:
        yield
    finally:
        _forced.reset(token)


def asked_for() -> str:
    """One of `NAMES`: what `ray_queries` says here, or else the environment variable.

    Raises:
        SceneError: The variable has another value.
    """
    return _forced.get() or checked(os.environ.get(VARIABLE) or "auto")


def checked(name: str) -> str:
    """A name that is one of `NAMES`."""
    if name not in NAMES:
        raise SceneError(f"unknown way of ray queries '{name}'{near_miss(name, NAMES)}")
    return name
