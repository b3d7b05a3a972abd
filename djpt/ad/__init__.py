"""Optimisers under the name that Mitsuba scripts use, those of `drjit.opt`, and what else its `ad` holds.

opt = djpt.ad.Adam(lr=0.05, params={key: params[key]})
"""

from __future__ import annotations

import importlib
from typing import Any

from djpt.ad.optimizers import SGD, Adam, AdamW, GradScaler, Optimizer, RMSProp

__all__ = ["SGD", "Adam", "AdamW", "GradScaler", "Optimizer", "RMSProp"]

MODULES = {
    "common": "djpt.ad.integrators.common",
    "guiding": "djpt.ad.guiding",
    "integrators": "djpt.ad.integrators",
    "largesteps": "djpt.ad.largesteps",
    "loaders": "djpt.ad.loaders",
    "optimizers": "djpt.ad.optimizers",
    "prb": "djpt.ad.integrators.prb",
    "prb_basic": "djpt.ad.integrators.prb_basic",
    "projective": "djpt.ad.projective",
    "ray_loader": "djpt.ad.loaders.ray_loader",
}
"""Attributes that are modules, which optimisers don't need."""

NAMES = {
    **dict.fromkeys(("BaseGuidingDistr", "GridDistr", "OcSpaceDistr", "UniformDistr"), "djpt.ad.guiding"),
    "FlatSensor": "djpt.ad.loaders",
    "LargeSteps": "djpt.ad.largesteps",
    "ProjectiveDetail": "djpt.ad.projective",
    "RayDataLoader": "djpt.ad.loaders",
}
"""Names that optimisers don't need, and their modules."""


def __getattr__(name: str) -> Any:
    """Import a module, or what is defined in one, when it is first used (PEP 562)."""
    if name in MODULES:
        return importlib.import_module(MODULES[name])
    if name in NAMES:
        return getattr(importlib.import_module(NAMES[name]), name)
    raise AttributeError(f"module 'djpt.ad' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *MODULES, *NAMES])
