"""The Python object that a record belongs to, in a form that Dr.Jit carries through its operations."""

from __future__ import annotations

import threading
import weakref
from typing import Any

from djpt.errors import RenderError

__all__ = ["SceneRef", "latest_scene_ref", "note_latest", "only", "scene_of"]

SceneRef = dict[Any, tuple[()]]
"""A reference to a scene: it is the only key. Dr.Jit keeps the keys of dicts whatever it does with their values."""


class Latest(threading.local):
    """The scene that a thread has loaded, rendered or asked for hits last, if it still exists.

    Records that a script makes by `dr.zeros` belong to it. They have to belong to one from the beginning: a loop of
    Dr.Jit makes its results of the state that it began with, keys of dicts included, and doesn't look at the keys of
    what the body returns. A record that began without a scene would lose that of the hits found in the loop.
    """

    scene: weakref.ref[Any] | None = None


_latest = Latest()


def note_latest(scene: Any) -> None:
    """Make `scene` the one that records made by `dr.zeros` in this thread belong to."""
    _latest.scene = weakref.ref(scene)


def latest_scene_ref() -> SceneRef:
    """The scene of records made by `dr.zeros`, so that they fit into loops and selects with those of hits."""
    scene = None if _latest.scene is None else _latest.scene()
    return {} if scene is None else {scene: ()}


def scene_of(record: Any) -> Any:
    """The scene that a record belongs to; raise `RenderError` if there is none."""
    for scene in record.scene_ref:
        return scene
    raise RenderError(f"this {type(record).__name__} belongs to no scene: it wasn't found by a ray")


def only(entries: tuple[Any, ...]) -> Any:
    """The entry of a field that may be missing, or None."""
    return entries[0] if entries else None
