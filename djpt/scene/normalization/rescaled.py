"""Textures and volumes whose numbers have a unit of length in them, in the units of a working frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from djpt.description.plugin import ParamFlags, Plugin
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector2f, Vector3f
from djpt.textures.base import Texture
from djpt.volumes.base import Volume

__all__ = ["rescaled"]


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
