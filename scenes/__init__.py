"""Built-in scenes, as functions that return dicts."""

from __future__ import annotations

if __name__ != "djpt.scenes":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.scenes instead")

from collections.abc import Callable
from typing import Any

from djpt.scenes.analytic import furnace
from djpt.scenes.cornell import cornell_box, cornell_box_boxfilter, cornell_box_spheres
from djpt.scenes.gallery import shader_ball
from djpt.scenes.stage import sky, stage

__all__ = [
    "SCENES",
    "cornell_box",
    "cornell_box_boxfilter",
    "cornell_box_spheres",
    "furnace",
    "shader_ball",
    "sky",
    "stage",
]

SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "cornell_box": cornell_box,
    "cornell_box_boxfilter": cornell_box_boxfilter,
    "cornell_box_spheres": cornell_box_spheres,
    "furnace": furnace,
    "shader_ball": shader_ball,
    "stage": stage,
}
"""The functions of the built-in scenes by name, for the command line. Each call makes a new dict."""
