"""Light of a lamp without size, in the units of a working frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from djpt.description.plugin import ParamFlags
from djpt.kernels import as_float
from djpt.textures.base import Texture
from djpt.types import Bool, Color3f, Float, Point2f

__all__ = ["Rescaled"]


class Rescaled(Texture):
    """A constant texture times a number: an intensity whose lamp has been moved to another scale."""

    is_constant = True
    values: ClassVar[Mapping[str, ParamFlags]] = {"factor": ParamFlags.NonDifferentiable}
    children = ("texture",)

    @staticmethod
    def of(texture: Texture, factor: float) -> Texture:
        """`factor` times a texture; the texture itself for 1."""
        if factor == 1:
            return texture
        made = (Rescaled if texture.is_constant else RescaledPicture)(texture.id())
        made.texture, made.factor = texture, as_float(factor)
        return made

    def __init__(self, name: str) -> None:
        super().__init__()
        self.set_id(name)
        self.texture: Texture
        self.factor: Float

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        return self.texture.eval(si, active) * self.factor

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        return self.texture.eval_1(si, active) * self.factor

    def mean(self) -> Float:
        return self.texture.mean() * self.factor

    def max(self) -> float:
        return self.texture.max() * float(self.factor[0])


class RescaledPicture(Rescaled):
    """A texture that varies times a number."""

    is_constant = False

    def sample_position(self, sample: Point2f, active: Bool | bool = True) -> tuple[Point2f, Float]:
        return self.texture.sample_position(sample, active)

    def pdf_position(self, p: Point2f, active: Bool | bool = True) -> Float:
        return self.texture.pdf_position(p, active)
