"""Lookups that gradients follow, for scripts that ask plugins lane by lane.

Rendering suspends the tracking of gradients and attaches what it differentiates itself. A script that evaluates a BSDF
where gradients are tracked expects the result to depend on the parameters of the scene.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from weakref import WeakKeyDictionary

import drjit as dr

from djpt.dispatch.ensemble import Attached, Detached, Ensemble, Lookup
from djpt.jit.types import Float

__all__ = ["followed", "prepare_followed"]

_latest: WeakKeyDictionary[Ensemble[Any], tuple[Any, Attached]] = WeakKeyDictionary()
"""The lookups that were made last for each ensemble, with the values that they were made for: for use in loops."""


def is_tracking() -> bool:
    """True if gradients are tracked here, and not suspended."""
    probe = Float(0)
    dr.enable_grad(probe)
    return bool(dr.grad_enabled(probe))


def followed(ensemble: Ensemble[Any], values: Lookup) -> Lookup:
    """`values`, or if some values of the ensemble have gradients, and these are tracked, lookups attached to them.

    Within a loop that Dr.Jit records tables can't be made: there it is `values`, unless there are tables from before.
    Outside of loops they are made anew, because a traversal cuts the way from them to the values.
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
    if dr.flag(dr.JitFlag.SymbolicScope):
        made = _latest.get(ensemble)
        return made[1] if made is not None and made[0] == key else values
    attached = Attached(found)
    attached.prepare(ensemble.leaves())
    _latest[ensemble] = key, attached
    return attached


def prepare_followed(ensembles: Iterable[Ensemble[Any]], values: Lookup) -> None:
    """Make the tables that a script's loop will need if it tracks gradients."""
    if type(values) is not Detached or dr.flag(dr.JitFlag.SymbolicScope):
        return
    with dr.resume_grad():
        for ensemble in ensembles:
            followed(ensemble, values)
