"""Volumes as paint: surfaces carved out of a block of material."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_texture
from djpt.jit.types import Bool, Color3f, Float
from djpt.textures.base import Texture
from djpt.volumes.base import Volume

__all__ = ["VolumeTexture"]


class VolumeTexture(Texture):
    """The colour of a volume at the point of the surface: for shapes without useful texture coordinates.

    Parameters: `volume` (a volume, number or colour, default 0.75), which is looked up in world space.
    """

    in_any_frame = True
    children: ClassVar[Sequence[str]] = ("volume",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.volume: Volume = props.volume("volume", 0.75)

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        return self.volume.eval(si, active)

    def eval_3(self, si: Any, active: Bool | bool = True) -> Color3f:
        return self.volume.eval_3(si, active)

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        return self.volume.eval_1(si, active)

    def max(self) -> float:
        return self.volume.max()

    def mean(self) -> Float:
        """The mean of the whole volume: the part that a shape shows isn't known."""
        return self.volume.mean()

    def restrict(self, allowed: Allowed, where: str) -> None:
        self.volume.restrict(allowed, where)


register_texture("volume", VolumeTexture)
