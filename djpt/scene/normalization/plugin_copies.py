"""Copies of plugins in a working frame."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import NotMovable, ParamFlags, Plugin
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector2f, Vector3f
from djpt.scene.normalization.normalized_scene import WorkingFrame
from djpt.textures.base import Texture
from djpt.volumes.base import Volume

__all__ = ["PluginCopies", "rescaled"]

OWN = ("shape", "emitter", "sensor")
"""Kinds of plugins that depend on the size of their scene: scenes in different frames can't share them."""


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


def rescaled(plugin: Texture | Volume, factor: float) -> Texture | Volume:
    """A texture or volume times a number. It holds the plugin itself, and follows edits and gradients of it."""
    if isinstance(plugin, Texture):
        return (Constant if plugin.is_constant else Picture)(plugin, factor)
    return (ConstantVolume if plugin.is_constant else Block)(plugin, factor)


class Constant(Texture):
    """A constant texture times a number."""

    is_constant = True
    values: ClassVar[Mapping[str, ParamFlags]] = {"factor": ParamFlags.NonDifferentiable}
    children = ("texture",)

    def __init__(self, texture: Texture, factor: float) -> None:
        super().__init__()
        self.set_id(texture.id())
        self.texture, self.factor = texture, as_float(factor)

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        return self.texture.eval(si, active) * self.factor

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        return self.texture.eval_1(si, active) * self.factor

    def eval_1_grad(self, si: Any, active: Bool | bool = True) -> Vector2f:
        return self.texture.eval_1_grad(si, active) * self.factor

    def mean(self) -> Float:
        return self.texture.mean() * self.factor

    def max(self) -> float:
        return self.texture.max() * float(self.factor[0])


class Picture(Constant):
    """A texture that varies times a number."""

    is_constant = False

    def sample_position(self, sample: Point2f, active: Bool | bool = True) -> tuple[Point2f, Float]:
        return self.texture.sample_position(sample, active)

    def pdf_position(self, p: Point2f, active: Bool | bool = True) -> Float:
        return self.texture.pdf_position(p, active)


class Block(Volume):
    """A volume times a number."""

    values: ClassVar[Mapping[str, ParamFlags]] = {"factor": ParamFlags.NonDifferentiable}
    children = ("volume",)

    def __init__(self, volume: Volume, factor: float) -> None:
        Plugin.__init__(self)
        self.set_id(volume.id())
        self.volume, self.factor = volume, as_float(factor)
        self.to_world = volume.to_world

    @property
    def is_grey(self) -> bool:
        return self.volume.is_grey

    def eval(self, it: Any, active: Bool | bool = True) -> Color3f:
        return self.volume.eval(it, active) * self.factor

    def eval_1(self, it: Any, active: Bool | bool = True) -> Float:
        return self.volume.eval_1(it, active) * self.factor

    def eval_3(self, it: Any, active: Bool | bool = True) -> Vector3f:
        return self.volume.eval_3(it, active) * self.factor

    def mean(self) -> Float:
        return self.volume.mean() * self.factor

    def max(self) -> float:
        return self.volume.max() * float(self.factor[0])


class ConstantVolume(Block):
    """A volume that is the same everywhere times a number."""

    is_constant = True
