"""The choice of how rays are traced through trees.

``call``
    By functions that Python writes and LLVM compiles: see `djpt.geometry.bvh.calls`.
``steps``
    By steps that all lanes of a kernel take together: see `djpt.geometry.bvh.steps`. Works everywhere.
``auto``
    By calls if they work on this machine. They are faster in nearly all cases: docs/performance.md, "Calls and steps".
"""

from __future__ import annotations

from djpt.errors import SceneError
from djpt.geometry.bvh.calls.trees import CompiledTrees, why_not
from djpt.geometry.bvh.steps.trees import StepTrees
from djpt.geometry.ray_queries import NAMES, VARIABLE, asked_for, ray_queries

__all__ = ["NAMES", "VARIABLE", "chosen", "new_trees", "ray_queries"]


def chosen() -> str:
    """The way for scenes that are loaded now: `call` or `steps`.

    Raises:
        SceneError: What was asked for isn't one of `NAMES`, or it is `call` and that doesn't work on this machine.
    """
    asked = asked_for()
    if asked == "steps":
        return asked
    reason = why_not()
    if reason is None:
        return "call"
    if asked == "call":
        raise SceneError(f"ray queries by calls don't work: {reason}; possible: steps")
    return "steps"


def new_trees() -> StepTrees | CompiledTrees:
    """The trees of a new scene."""
    return CompiledTrees() if chosen() == "call" else StepTrees()
