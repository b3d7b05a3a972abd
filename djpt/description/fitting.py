"""The kinds of plugins that fit where a node stands, so that messages list only those."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from djpt.description.registry import kind_of

__all__ = ["fitting_kinds"]

NESTED: dict[str, tuple[str, ...]] = {
    "scene": (
        *("sensor", "integrator", "bsdf", "texture", "emitter", "shape", "sampler", "film", "rfilter"),
        *("medium", "phase", "volume"),
    ),
    "shape": ("bsdf", "emitter", "sensor", "medium", "texture", "shape"),
    "sensor": ("film", "sampler", "medium", "texture", "sensor", "shape"),
    "film": ("rfilter",),
    "bsdf": ("texture", "bsdf"),
    "emitter": ("texture", "medium"),
    "medium": ("volume", "phase", "texture"),
    "phase": ("volume", "phase", "texture"),
    "volume": ("texture", "volume"),
    "texture": ("texture", "volume"),
    "integrator": ("integrator",),
}
"""The kinds that a plugin of each kind holds."""

PLACES = {"interior": "medium", "exterior": "medium", "target": "shape"}
"""The kinds of nodes whose keys mean one kind; so do keys that are named after a kind, such as ``integrator``."""


def fitting_kinds(parent: Mapping[str, Any] | None, key: str) -> tuple[str, ...] | None:
    """The kinds of plugins that fit under a key of a node; None if any may."""
    held = NESTED.get(kind_of(str(parent.get("type"))) or "") if parent is not None else None
    meant = PLACES.get(key, key)
    return (meant,) if held is not None and meant in held else held
