"""Parameter sets of every emitter: what the tests of all emitters run over.

An emitter is described by the entries that it adds to a scene; those `on_shape` come with their shape.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from djpt.transforms import ScalarTransform4f as T
from djpt.types import TensorXf

__all__ = ["NAMES", "UNLIKE_MITSUBA", "entry", "plugin_of"]

RECTANGLE = {
    "type": "rectangle",
    "to_world": T().look_at(origin=[-2, 3, 2.5], target=[0, 0, 0], up=[0, 1, 0]).scale(0.7),
}


def picture(shape: dict[str, Any], **keys: Any) -> Callable[[], dict[str, Any]]:
    """A shape that shines with the colours of a bitmap; made anew, since Mitsuba takes the tensor's memory."""
    data = (6 * np.random.default_rng(0).random((6, 8, 3)) ** 4).astype(np.float32)

    def make() -> dict[str, Any]:
        texture = {"type": "bitmap", "data": TensorXf(data), "raw": True, **keys}
        return {**shape, "emitter": {"type": "area", "radiance": texture}}

    return make


SETS: dict[str, dict[str, dict[str, Any] | Callable[[], dict[str, Any]]]] = {
    "area": {
        "rectangle": {**RECTANGLE, "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [6, 5, 4]}}},
        "sphere": {
            "type": "sphere",
            "center": [-2, 3, 2.5],
            "radius": 0.5,
            "emitter": {"type": "area", "radiance": 8.0},
        },
        "bitmap rectangle": picture(RECTANGLE),
        "nearest bitmap rectangle": picture(RECTANGLE, filter_type="nearest", wrap_mode="clamp"),
        "turned bitmap rectangle": picture(RECTANGLE, to_uv=T().translate([0, 1, 0]).scale([1, -1, 1])),
        "bitmap sphere": picture({"type": "sphere", "center": [-2, 3, 2.5], "radius": 0.5}, wrap_mode="mirror"),
        "bitmap cylinder": picture({"type": "cylinder", "p0": [-2, 3, 2.5], "p1": [-1.5, 3, 2], "radius": 0.4}),
        "bitmap cube": picture({"type": "cube", "to_world": T().translate([-2, 3, 2.5]).scale(0.4)}),
        "checkerboard disk": {
            **RECTANGLE,
            "type": "disk",
            "emitter": {"type": "area", "radiance": {"type": "checkerboard", "color0": 8.0, "color1": 1.0}},
        },
    },
    "constant": {"colour": {"type": "constant", "radiance": {"type": "rgb", "value": [0.4, 0.5, 0.6]}}},
    "point": {
        "position": {"type": "point", "position": [-2, 3, 2.5], "intensity": {"type": "rgb", "value": [9, 8, 7]}},
    },
}
"""Plugin -> name of the set -> the scene's entry."""

UNLIKE_MITSUBA = {
    "area-turned bitmap rectangle": "Mitsuba 3.9.1 samples a bitmap as if it had no `to_uv`",
    "area-bitmap cylinder": "Mitsuba 3.9.1 finds some points of a tilted cylinder on the wall opposite",
    "area-bitmap cube": "Mitsuba 3.9.1 samples one face of a cube, since all have the same uv",
}
"""Sets that Mitsuba samples in another way, and why: see tests/test_textured_lights.py."""

NAMES = [f"{plugin}-{name}" for plugin, sets in SETS.items() for name in sets]


def entry(name: str) -> dict[str, Any]:
    """The scene's entry for one of `NAMES`."""
    plugin, _, which = name.partition("-")
    found = SETS[plugin][which]
    return found() if callable(found) else found


def plugin_of(name: str) -> str:
    """The emitter plugin of one of `NAMES`."""
    return name.partition("-")[0]
