"""Built-in scenes, as functions that return dicts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if __name__ != "djpt.scenes":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.scenes instead")

NAMES = (
    *("cornell_box", "cornell_box_boxfilter", "cornell_box_spheres", "door_ajar", "fixture", "furnace", "glass_ball"),
    *("lamp_behind_pane", "lamp_in_glass", "parabolic_mirror", "pool", "shader_ball", "stage"),
)
"""The keys of `SCENES`, for commands that need one of them only."""

if TYPE_CHECKING:
    from djpt.scenes.catalogue import SCENES as SCENES
    from djpt.scenes.cornell import cornell_box as cornell_box
    from djpt.scenes.cornell import cornell_box_boxfilter as cornell_box_boxfilter
    from djpt.scenes.cornell import cornell_box_spheres as cornell_box_spheres
    from djpt.scenes.cornell import furnace as furnace
    from djpt.scenes.gallery import shader_ball as shader_ball
    from djpt.scenes.light_paths import door_ajar as door_ajar
    from djpt.scenes.light_paths import fixture as fixture
    from djpt.scenes.light_paths import glass_ball as glass_ball
    from djpt.scenes.light_paths import lamp_behind_pane as lamp_behind_pane
    from djpt.scenes.light_paths import lamp_in_glass as lamp_in_glass
    from djpt.scenes.light_paths import parabolic_mirror as parabolic_mirror
    from djpt.scenes.light_paths import pool as pool
    from djpt.scenes.light_paths import sky as sky
    from djpt.scenes.light_paths import stage as stage
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
