"""The choice of how rays are traced through trees.

``call``
    By functions that Python writes and LLVM compiles: see `djpt.geometry.compiled`.
``steps``
    By steps that all lanes of a kernel take together: see `djpt.geometry.bvh`. Works everywhere.
``auto``
    By calls if they work on this machine. They are faster in nearly all cases: docs/performance.md, "Calls and steps".
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from djpt.errors import SceneError, near_miss
from djpt.geometry.bvh.step_trees import StepTrees
from djpt.geometry.compiled.engine import why_not
from djpt.geometry.compiled.trees import CompiledTrees

__all__ = ["NAMES", "VARIABLE", "chosen", "new_trees", "ray_queries"]

NAMES = ("auto", "call", "steps")

VARIABLE = "DJPT_RAY_QUERIES"
"""The environment variable for one of `NAMES`."""

_forced: list[str] = []


@contextmanager
def ray_queries(name: str) -> Iterator[None]:
    """Let scenes that are loaded inside trace rays in one of the ways `auto`, `call`, `steps`.

    Raises:
        SceneError: Another name.
    """
    _forced.append(checked(name))
    try:
        yield
    finally:
        _forced.pop()


def chosen() -> str:
    """The way for scenes that are loaded now: `call` or `steps`.

    Raises:
        SceneError: What was asked for isn't one of `NAMES`, or it is `call` and that doesn't work on this machine.
    """
    asked = _forced[-1] if _forced else checked(os.environ.get(VARIABLE) or "auto")
    if asked == "steps":
        return asked
    reason = why_not()
    if reason is None:
        return "call"
    if asked == "call":
        raise SceneError(f"ray queries by calls don't work: {reason}; possible: steps")
    return "steps"


def checked(name: str) -> str:
    """A name that is one of `NAMES`."""
    if name not in NAMES:
        raise SceneError(f"unknown way of ray queries '{name}'{near_miss(name, NAMES)}")
    return name


def new_trees() -> StepTrees | CompiledTrees:
    """The trees of a new scene."""
    return CompiledTrees() if chosen() == "call" else StepTrees()
