"""Per-lane textures, for scripts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.dispatch.family import Pointer
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector2f
from djpt.textures.base import Texture

__all__ = ["TexturePtr"]


class TexturePtr(Pointer[Texture]):
    """The texture of each lane, or none. Methods as in `djpt.Texture`; 0 where there is none."""

    member_kind = "texture"

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        """The colour at `si`."""
        return self._ask(lambda texture: Color3f(texture.eval(si, active)), Color3f(0), active)

    def eval_3(self, si: Any, active: Bool | bool = True) -> Color3f:
        """The colour at `si`: `eval`, since colours have three channels."""
        return self.eval(si, active)

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        """The scalar at `si`."""
        return self._ask(lambda texture: Float(texture.eval_1(si, active)), Float(0), active)

    def eval_1_grad(self, si: Any, active: Bool | bool = True) -> Vector2f:
        """The change of `eval_1` per unit of u and of v."""
        return self._ask(lambda texture: Vector2f(texture.eval_1_grad(si, active)), Vector2f(0), active)

    def sample_position(self, sample: Any, active: Bool | bool = True) -> tuple[Point2f, Float]:
        """A point (u, v) of the unit square where the texture is bright, and its density."""
        for i in self.present():
            self.plugins[i].prepare_sampling()
        return self.each(lambda texture, mine: texture.sample_position(Point2f(sample), mine), (Point2f(0), Float(0)))

    def pdf_position(self, p: Any, active: Bool | bool = True) -> Float:
        """The density of `sample_position` per unit of uv."""
        for i in self.present():
            self.plugins[i].prepare_sampling()
        density = self.each(lambda texture, mine: texture.pdf_position(Point2f(p), mine), Float(0))
        return dr.select(active, density, 0)

    def mean(self) -> Float:
        """The averages of the textures."""
        return self.each(lambda texture, mine: Float(texture.mean()), Float(0))

    def max(self) -> Float:
        """The largest values of the textures."""
        return self.each(lambda texture, mine: Float(texture.max()), Float(0))

    def is_spatially_varying(self) -> Bool:
        """True where the texture can differ from point to point."""
        return self.holds(lambda texture: texture.is_spatially_varying())

    def _ask(self, method: Callable[[Texture], Any], nothing: Any, active: Bool | bool) -> Any:
        return dr.select(active, self.ensemble.call(self.index, self.lookup, method, nothing), nothing)
