"""Silhouettes of the shapes of pointers: a shape per lane."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr

from djpt.core.lookup import choose
from djpt.dispatch.ensemble import Ensemble, Lookup
from djpt.dispatch.family import NONE, SCRIPT_PLUGINS
from djpt.jit.types import Bool, UInt32
from djpt.shapes.silhouettes.base import Silhouette
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["ask", "numbered"]


def numbered(ss: SilhouetteSample3f, shapes: Sequence[Any], index: UInt32) -> SilhouetteSample3f:
    """Let samples refer to their shapes, `shapes[index]`; those of none stay so."""
    numbers = [SCRIPT_PLUGINS.number(getattr(shape, "original", None) or shape) for shape in shapes]
    number = choose(index, [UInt32(n) for n in numbers], numbers)
    ss.number = dr.select((ss.number == NONE) | (index >= len(shapes)), NONE, number)
    return ss


def ask(
    ensemble: Ensemble[Any], index: UInt32, lookup: Lookup, question: Callable[[Silhouette, Bool], Any], otherwise: Any
) -> Any:
    """``question(silhouette, mine)`` per lane; `otherwise` where there is no shape, or its silhouettes aren't known.

    Analytic shapes of a class are asked together. Meshes and curves have arrays of their own, and so are asked one by
    one: `mine` are the lanes of the one that is asked, of which alone the numbers of primitives are its own.
    """
    result = otherwise
    for group in ensemble.groups:
        if group.plugins[0].silhouette_class() is None:
            continue
        if group.plugins[0].points_parameter:
            for number, mesh in zip(group.indices, group.plugins, strict=True):
                mine = index == number
                result = dr.select(mine, question(mesh.silhouette(), mine), result)
        else:
            found = question(group.at(ensemble.slots(group, index), lookup).silhouette(), Bool(True))
            result = dr.select(ensemble.members(group, index), found, result)
    return result
