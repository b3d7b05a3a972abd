"""All built-in scenes at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from djpt.scenes.cornell import cornell_box, cornell_box_boxfilter, cornell_box_spheres, furnace
from djpt.scenes.gallery import shader_ball
from djpt.scenes.light_paths import (
    door_ajar,
    fixture,
    glass_ball,
    lamp_behind_pane,
    lamp_in_glass,
    parabolic_mirror,
    stage,
)

__all__ = ["SCENES"]

SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    scene.__name__: scene
    for scene in (
        *(cornell_box, cornell_box_boxfilter, cornell_box_spheres, door_ajar, fixture, furnace, glass_ball),
        *(lamp_behind_pane, lamp_in_glass, parabolic_mirror, shader_ball, stage),
    )
}
"""The functions of the built-in scenes by name. Each call makes a new dict."""
