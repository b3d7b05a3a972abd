"""Optimisers under the name that Mitsuba scripts use, those of `drjit.opt`, and differentiable integrators.

opt = djpt.ad.Adam(lr=0.05, params={key: params[key]})
"""

from __future__ import annotations

import importlib
from typing import Any

from drjit.opt import SGD, Adam, AdamW, GradScaler, Optimizer, RMSProp

__all__ = ["SGD", "Adam", "AdamW", "GradScaler", "Optimizer", "RMSProp"]

MODULES = {
    "common": "djpt.ad.integrators.common",
    "guiding": "djpt.ad.guiding",
    "integrators": "djpt.ad.integrators",
    "projective": "djpt.ad.projective",
}
"""Attributes that are modules, which optimisers don't need."""

NAMES = dict.fromkeys(("BaseGuidingDistr", "GridDistr", "OcSpaceDistr", "UniformDistr"), "djpt.ad.guiding")
NAMES["ProjectiveDetail"] = "djpt.ad.projective"
"""Attributes that are defined in such modules."""


def __getattr__(name: str) -> Any:
    """Import a module when it is first used (PEP 562)."""
    if name in MODULES:
        return importlib.import_module(MODULES[name])
    if name in NAMES:
        return getattr(importlib.import_module(NAMES[name]), name)
    raise AttributeError(f"module 'djpt.ad' has no attribute {name!r}")
