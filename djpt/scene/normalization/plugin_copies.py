"""Copies of plugins in a working frame."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import NotMovable, Plugin
from djpt.scene.normalization.frame import WorkingFrame
from djpt.scene.normalization.rescaled import rescaled

__all__ = ["PluginCopies"]

OWN = ("shape", "emitter", "sensor")
"""Kinds of plugins that a scene tells how large it is: they can't be shared with a scene in another frame."""


class PluginCopies:
    """The `djpt.description.plugin.Frame` that plugins move into: it makes one copy of each.

    A copy in which nothing has changed is dropped, and the plugin shared by both scenes.
    """

    def __init__(self, frame: WorkingFrame) -> None:
        self._frame = frame
        # The originals are kept, so that their ids stay taken.
        self._copies: dict[int, tuple[Plugin, Plugin]] = {}

    # ---- the map -------------------------------------------------------------------------

    @property
    def scale(self) -> float:
        """The length of the unit in the frame: a power of two."""
        return self._frame.scale

    def point(self, p: Any) -> NDArray[np.float64]:
        """Points (3,) or (N, 3) of the scene, in the frame."""
        return self._frame.point(p)

    def moved(self, to_world: ScalarTransform4f) -> ScalarTransform4f:
        """The `to_world` in the frame of something that has a size."""
        return self._frame.transform @ to_world

    def moved_unscaled(self, to_world: ScalarTransform4f) -> ScalarTransform4f:
        """The `to_world` in the frame of something without a size."""
        matrix = np.array(to_world.matrix)
        matrix[:3, 3] = self.point(matrix[:3, 3])
        return ScalarTransform4f(matrix)

    def rescaled(self, plugin: Any, power: int) -> Any:
        """A texture or volume times a power of the scale; itself for a scale of 1, and None for None."""
        return plugin if plugin is None or self.scale == 1 else rescaled(plugin, self.scale**power)

    # ---- plugins -------------------------------------------------------------------------

    def copy_of(self, plugin: Any) -> Any:
        """A plugin in the frame: a copy, always the same, or itself if nothing in it differs there.

        Raises:
            NotMovable: it can't be moved.
        """
        if not isinstance(plugin, Plugin):
            return plugin
        if id(plugin) not in self._copies:
            copied = self.copied(plugin)
            # Before it moves: shapes and their emitters refer to each other.
            self._copies[id(plugin)] = plugin, copied
            try:
                copied.move_into(self)
            except NotMovable:
                del self._copies[id(plugin)]
                raise
            if plugin.kind not in OWN and is_equal(plugin, copied):
                self._copies[id(plugin)] = plugin, plugin
        return self._copies[id(plugin)][1]

    def copied(self, plugin: Any) -> Any:
        """A copy of a plugin that hasn't moved.

        Raises:
            NotMovable: its class doesn't say how it moves.
        """
        kind = type(plugin)
        if not ("move_into" in vars(kind) or kind.says("in_any_frame")):
            raise NotMovable(f"{plugin.id()}: '{kind.__name__}' has no move_into of its own and isn't in_any_frame")
        return copy.copy(plugin)

    def shares(self, plugin: Plugin) -> bool:
        """Whether the frame has no copy of a plugin: an edit of it then reaches the frame by itself."""
        return self._copies.get(id(plugin), (plugin, plugin))[1] is plugin

    def possible(self, plugins: Iterable[Plugin]) -> list[Any]:
        """The copies of those plugins that can be carried."""
        copies = []
        for plugin in plugins:
            with suppress(NotMovable):
                copies.append(self.copy_of(plugin))
        return copies

    def again(self, sensor: Any) -> Any:
        """A sensor in the frame as it is now, with its film.

        Raises:
            NotMovable: it can't be moved.
        """
        for plugin, _ in list(self._copies.values()):
            if plugin.kind == "sensor" and getattr(plugin, "shape", None) is None:
                del self._copies[id(plugin)]
        copied = self.copy_of(sensor)
        copied.take_film(sensor.film())
        return copied


def is_equal(plugin: Plugin, copied: Plugin) -> bool:
    """Whether no attribute of a copy has changed."""
    before, after = vars(plugin), vars(copied)
    return before.keys() == after.keys() and all(before[name] is after[name] for name in before)
