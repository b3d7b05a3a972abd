"""The choice of how rays are traced through trees.

``rings``
    By functions that Python writes and LLVM compiles, which search for all rays of a packet side by side: see
    `djpt.geometry.bvh.calls.rings`. On processors with AVX2.
``call``
    By such functions that search for one ray after the other: see `djpt.geometry.bvh.calls.traversal`.
``steps``
    By steps that all lanes of a kernel take together: see `djpt.geometry.bvh.steps`. Works everywhere.
``auto``
    The first of these that works on this machine, which is the fastest in nearly all cases: docs/performance.md, "Calls
    and steps". If it is one of the first two, few flat faces are all tested instead: see
    `djpt.geometry.bvh.calls.faces`.
"""

from __future__ import annotations

from djpt.errors import SceneError
from djpt.geometry.bvh.calls.searches import SEARCHES, why_not
from djpt.geometry.bvh.calls.trees import CompiledTrees
from djpt.geometry.bvh.steps.trees import StepTrees
from djpt.geometry.ray_queries import NAMES, VARIABLE, asked_for, ray_queries

__all__ = ["NAMES", "VARIABLE", "chosen", "new_trees", "ray_queries"]


def chosen() -> str:
    """The way for scenes that are loaded now: `rings`, `call` or `steps`.

    Raises:
        SceneError: What was asked for isn't one of `NAMES`, or doesn't work on this machine.
    """
    asked = asked_for()
    if asked == "auto":
        return next((search for search in SEARCHES if why_not(search) is None), "steps")
    if asked in SEARCHES and (reason := why_not(asked)) is not None:
        others = [search for search in SEARCHES if why_not(search) is None]
        raise SceneError(f"ray queries by '{asked}' don't work: {reason}; possible: {', '.join([*others, 'steps'])}")
    return asked


def new_trees() -> StepTrees | CompiledTrees:
    """The trees of a new scene."""
    search = chosen()
    return CompiledTrees(search, asked_for() == "auto") if search in SEARCHES else StepTrees()
