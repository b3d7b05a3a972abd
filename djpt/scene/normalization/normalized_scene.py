"""The twin of a scene in its working frame, which is rendered in its place."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

from djpt.description.frame_change import Rooted
from djpt.jit.frozen import recording
from djpt.jit.kernels import may_wait
from djpt.scene.normalization.frame import working_frame

if TYPE_CHECKING:
    from djpt.scene.normalization.plugin_copies import Carrier
    from djpt.scene.scene import Scene
    from djpt.sensors import Sensor

__all__ = ["carried", "twin"]

CARRIED = ("shape", "emitter")
"""The kinds of plugins of which a twin has copies of its own from the beginning."""


def carried(scene: Scene, sensor: Sensor) -> tuple[Scene, Sensor]:
    """The scene and a sensor as they are rendered: in the working frame if there is one, else themselves."""
    found = twin(scene)
    if found is None:
        return scene, sensor
    carrier, of_scene = found
    try:
        # Anew each time: its film may have changed without the scene's knowledge.
        moved = carrier.again(sensor)
    except Rooted:
        return scene, sensor
    moved.set_bounds(*of_scene.bounding_sphere())
    return of_scene, moved


def twin(scene: Scene) -> tuple[Carrier, Scene] | None:
    """The scene in its working frame, and what carries plugins there; None if its own coordinates will do, or must."""
    if scene.twin == ():
        if recording():
            return None  # what is made now belongs to the recorded function
        scene.twin = made(scene)
    found: Any = scene.twin
    return found or None


def made(scene: Scene) -> tuple[Carrier, Scene] | None:
    """Compile the twin."""
    frame = working_frame(scene)
    if frame is None:
        return None
    # Most scenes don't need these.
    from djpt.scene.normalization.plugin_copies import Carrier
    from djpt.scene.normalization.units import Units

    carrier = Carrier(frame)
    view = copy.copy(scene)
    view.is_view, view.units = True, Units(frame)
    try:
        view._shapes = [carrier.carried(shape) for shape in scene._shapes]
        view._emitters = [carrier.carried(emitter) for emitter in scene._emitters]
        view._sensors = carrier.possible(scene._sensors)
        view.named = [
            (key, carrier.carried(plugin) if plugin.kind in CARRIED else plugin) for key, plugin in scene.named
        ]
    except Rooted:
        return None
    with may_wait():
        view._compile()
    view.twin = None
    return carrier, view
