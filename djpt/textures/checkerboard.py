"""Two textures in a chequered pattern."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_texture
from djpt.jit.types import Bool, Color3f, Float, UInt32, Vector2f
from djpt.textures.uv import UVTexture

__all__ = ["Checkerboard"]


class Checkerboard(UVTexture):
    """A pattern of two textures: `color0` where u mod 1 and v mod 1 lie on the same side of 0.5, elsewhere `color1`.

    As a scalar (`eval_1`: a roughness, an opacity, the weight of a blend) it is the other way round: `color1` where
    they lie on the same side. So it is in Mitsuba 3.9.1, by measurement, also for checkerboards in checkerboards.

    Parameters: `color0` (texture, default 0.4), `color1` (texture, default 0.2), `to_uv` (see
    `djpt.textures.uv.UVTexture`; the nested textures don't see it). The fields are half a unit wide.
    """

    in_any_frame = True
    children = ("color0", "color1")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.color0 = props.texture("color0", 0.4)
        self.color1 = props.texture("color1", 0.2)

    def _is_even(self, si: Any) -> Bool:
        """True where u mod 1 and v mod 1 lie on the same side of 0.5."""
        uv = self.uv(si)
        right, upper = uv.x - dr.floor(uv.x) > 0.5, uv.y - dr.floor(uv.y) > 0.5
        return ~(right ^ upper)

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        even = self._is_even(si)
        return dr.select(even, self.color0.eval(si, even & active), self.color1.eval(si, ~even & active))

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        even = self._is_even(si)
        return dr.select(even, self.color1.eval_1(si, even & active), self.color0.eval_1(si, ~even & active))

    def eval_1_grad(self, si: Any, active: Bool | bool = True) -> Vector2f:
        """The gradient of the texture that `eval_1` shows; edges have none. Mitsuba 3.9.1 can't compute it."""
        even = self._is_even(si)
        one, other = self.color1.eval_1_grad(si, even & active), self.color0.eval_1_grad(si, ~even & active)
        return dr.select(even, one, other)

    def has_patches(self) -> bool:
        return True

    def patch(self, si: Any) -> UInt32:
        return dr.select(self._is_even(si), UInt32(0), UInt32(1))

    def mean(self) -> Float:
        return 0.5 * (self.color0.mean() + self.color1.mean())

    def max(self) -> float:
        return max(self.color0.max(), self.color1.max())

    def used_by(self, kind: str) -> None:
        self.color0.used_by(kind)
        self.color1.used_by(kind)

    def restrict(self, allowed: Allowed, where: str) -> None:
        self.color0.restrict(allowed, where)
        self.color1.restrict(allowed, where)

    def restrict_colors(self, allowed: Allowed, where: str) -> None:
        self.color0.restrict_colors(allowed, where)
        self.color1.restrict_colors(allowed, where)


register_texture("checkerboard", Checkerboard)
