"""Lookups that gradients follow, for scripts that ask plugins lane by lane.

Rendering suspends the tracking of gradients and attaches what it differentiates itself. A script that evaluates a BSDF
where gradients are tracked expects the result to depend on the parameters of the scene.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import drjit as dr

from djpt.dispatch.ensemble import Attached, Detached, Ensemble, Lookup
from djpt.types import Float

__all__ = ["followed"]

_made: WeakKeyDictionary[Ensemble[Any], tuple[Any, Attached]] = WeakKeyDictionary()
"""The lookups of ensembles, with the values that they were made for."""


def is_tracking() -> bool:
    """Whether gradients are tracked here, and not suspended."""
    probe = Float(0)
    dr.enable_grad(probe)
    return bool(dr.grad_enabled(probe))


def followed(ensemble: Ensemble[Any], values: Lookup) -> Lookup:
    """`values`, or if some values of the ensemble have gradients, and these are tracked, lookups attached to them.

    Within a loop that Dr.Jit records tables can't be made: there it is `values`, unless the ensemble was asked before.
    """
    if type(values) is not Detached or not is_tracking():
        return values
    found = {
        (id(owner), leaf.attribute): value
        for leaf in ensemble.leaves()
        for owner in leaf.owners
        if dr.grad_enabled(value := getattr(owner, leaf.attribute))
    }
    if not found:
        return values
    key = dr.detail.collect_indices(list(found.values()))
    made = _made.get(ensemble)
    if made is not None and made[0] == key:
        return made[1]
    if dr.flag(dr.JitFlag.SymbolicScope):
        return values
    attached = Attached(found)
    attached.prepare(ensemble.leaves())
    _made[ensemble] = key, attached
    return attached
