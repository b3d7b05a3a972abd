"""The copy of a scene in its working frame, which is rendered in its place."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

from djpt.description.frame_change import NotMovable
from djpt.jit.frozen import recording
from djpt.jit.kernels import may_wait
from djpt.scene.normalization.frame import working_frame

if TYPE_CHECKING:
    from djpt.scene.normalization.plugin_copies import PluginCopies
    from djpt.scene.scene import Scene
    from djpt.sensors import Sensor

__all__ = ["normalized", "normalized_scene"]

COPIED = ("shape", "emitter")
"""The kinds of plugins of which a normalized scene has copies of its own from the beginning."""


def normalized(scene: Scene, sensor: Sensor) -> tuple[Scene, Sensor]:
    """The scene and a sensor as they are rendered: in the working frame if there is one, else themselves."""
    found = normalized_scene(scene)
    if found is None:
        return scene, sensor
    copies, of_scene = found
    try:
        # Anew each time: its film may have changed without the scene's knowledge.
        moved = copies.again(sensor)
    except NotMovable:
        return scene, sensor
    moved.set_bounds(*of_scene.bounding_sphere())
    return of_scene, moved


def normalized_scene(scene: Scene) -> tuple[PluginCopies, Scene] | None:
    """The scene in its working frame, and the copies of its plugins; None if its own coordinates will do, or must."""
    if scene.normalized == ():
        if recording():
            return None  # what is made now belongs to the recorded function
        scene.normalized = made(scene)
    found: Any = scene.normalized
    return found or None


def made(scene: Scene) -> tuple[PluginCopies, Scene] | None:
    """Compile the normalized scene."""
    frame = working_frame(scene)
    if frame is None:
        return None
    # Most scenes don't need these.
    from djpt.scene.normalization.frame import Units
    from djpt.scene.normalization.plugin_copies import PluginCopies

    copies = PluginCopies(frame)
    view = copy.copy(scene)
    view.is_view, view.units = True, Units(frame)
    try:
        view._shapes = [copies.copy_of(shape) for shape in scene._shapes]
        view._emitters = [copies.copy_of(emitter) for emitter in scene._emitters]
        view._sensors = copies.possible(scene._sensors)
        view.named = [(key, copies.copy_of(plugin) if plugin.kind in COPIED else plugin) for key, plugin in scene.named]
    except NotMovable:
        return None
    with may_wait():
        view._compile()
    view.normalized = None
    return copies, view
