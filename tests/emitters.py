"""Parameter sets of every emitter: what the tests of all emitters run over.

An emitter is described by the entries that it adds to a scene; those `on_shape` come with their shape.
"""

from __future__ import annotations

from typing import Any

from djpt.transforms import ScalarTransform4f as T

__all__ = ["NAMES", "entry", "plugin_of"]

RECTANGLE = {
    "type": "rectangle",
    "to_world": T().look_at(origin=[-2, 3, 2.5], target=[0, 0, 0], up=[0, 1, 0]).scale(0.7),
}

SETS: dict[str, dict[str, dict[str, Any]]] = {
    "area": {
        "rectangle": {**RECTANGLE, "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [6, 5, 4]}}},
        "sphere": {
            "type": "sphere",
            "center": [-2, 3, 2.5],
            "radius": 0.5,
            "emitter": {"type": "area", "radiance": 8.0},
        },
    },
    "constant": {"colour": {"type": "constant", "radiance": {"type": "rgb", "value": [0.4, 0.5, 0.6]}}},
    "point": {
        "position": {"type": "point", "position": [-2, 3, 2.5], "intensity": {"type": "rgb", "value": [9, 8, 7]}},
    },
}
"""Plugin -> name of the set -> the scene's entry."""

NAMES = [f"{plugin}-{name}" for plugin, sets in SETS.items() for name in sets]


def entry(name: str) -> dict[str, Any]:
    """The scene's entry for one of `NAMES`."""
    plugin, _, which = name.partition("-")
    return SETS[plugin][which]


def plugin_of(name: str) -> str:
    """The emitter plugin of one of `NAMES`."""
    return name.partition("-")[0]
