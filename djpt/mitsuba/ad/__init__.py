"""Optimisers under the name that Mitsuba scripts use, those of `drjit.opt`, and what else its `ad` holds.

opt = djpt.mitsuba.ad.Adam(lr=0.05, params={key: params[key]})
"""

from __future__ import annotations

import importlib
from typing import Any

from djpt.mitsuba.ad.optimizers import SGD, Adam, AdamW, GradScaler, Optimizer, RMSProp

__all__ = ["SGD", "Adam", "AdamW", "GradScaler", "Optimizer", "RMSProp"]

MODULES = {
    "common": "djpt.mitsuba.ad.integrators.common",
    "guiding": "djpt.integrators.projective.guiding",
    "integrators": "djpt.mitsuba.ad.integrators",
    "largesteps": "djpt.mitsuba.ad.largesteps",
    "loaders": "djpt.mitsuba.ad.loaders",
    "optimizers": "djpt.mitsuba.ad.optimizers",
    "prb": "djpt.mitsuba.ad.integrators.prb",
    "prb_basic": "djpt.mitsuba.ad.integrators.prb_basic",
    "projective": "djpt.integrators.projective.detail",
    "ray_loader": "djpt.mitsuba.ad.loaders.ray_loader",
}
"""Attributes that are modules, which optimisers don't need."""

NAMES = {
    **dict.fromkeys(
        ("BaseGuidingDistr", "GridDistr", "OcSpaceDistr", "UniformDistr"), "djpt.integrators.projective.guiding"
    ),
    "FlatSensor": "djpt.mitsuba.ad.loaders",
    "LargeSteps": "djpt.mitsuba.ad.largesteps",
    "ProjectiveDetail": "djpt.integrators.projective.detail",
    "RayDataLoader": "djpt.mitsuba.ad.loaders",
}
"""Names that optimisers don't need, and their modules."""


def __getattr__(name: str) -> Any:
    """Import a module, or what is defined in one, when it is first used (PEP 562)."""
    if name in MODULES:
        return importlib.import_module(MODULES[name])
    if name in NAMES:
        return getattr(importlib.import_module(NAMES[name]), name)
    raise AttributeError(f"module 'djpt.mitsuba.ad' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *MODULES, *NAMES])
