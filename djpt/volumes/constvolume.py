"""Volumes that are the same everywhere."""

from __future__ import annotations

from typing import Any, ClassVar

from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_volume
from djpt.errors import SceneError
from djpt.jit.types import Bool, Color3f, Float, Vector3f
from djpt.textures.base import Texture
from djpt.textures.uniform import UniformTexture
from djpt.volumes.base import Volume

__all__ = ["ConstVolume"]


class ConstVolume(Volume):
    """One number or colour everywhere; numbers and colours in a description become this.

    Parameters: `value`, a number or a constant texture (default 1), and `to_world`.
    """

    in_any_frame = True
    is_constant = True
    children: ClassVar[tuple[str, ...]] = ("value",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.value: Texture = props.texture_1("value", 1.0)
        if not self.value.is_constant:
            raise SceneError(f"{props.node}: 'value' must be the same everywhere; a 'gridvolume' varies in space")

    @property
    def is_grey(self) -> bool:
        return isinstance(self.value, UniformTexture)

    def eval(self, it: Any, active: Bool | bool = True) -> Color3f:
        return self.value.eval(it, active)

    def eval_1(self, it: Any, active: Bool | bool = True) -> Float:
        """The number; of a colour the mean."""
        return self.value.mean()

    def eval_3(self, it: Any, active: Bool | bool = True) -> Vector3f:
        return self.value.eval(it, active)

    def eval_gradient(self, it: Any, active: Bool | bool = True) -> tuple[Color3f, Vector3f]:
        return self.eval(it, active), Vector3f(0)

    def mean(self) -> Float:
        return self.value.mean()

    def max(self) -> float:
        return self.value.max()

    def restrict(self, allowed: Allowed, where: str) -> None:
        self.value.restrict(allowed, where)


register_volume("constvolume", ConstVolume)
