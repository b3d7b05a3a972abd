"""Textures that a shape carries by a name, for scripts to look up at points of it."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import SceneError, near_miss
from djpt.jit.types import ArrayXf, Bool, Color3f, Float

__all__ = ["TextureAttributes"]


class TextureAttributes(Plugin):
    """The part of a shape that answers for its attributes: textures of any name, and what meshes hold.

    A texture that is nested in a shape is an attribute, whatever its key. The renderer doesn't look at it.
    """

    _textures: dict[str, Any]

    def take_textures(self, props: Properties) -> None:
        """Take the textures that are nested in the shape."""
        self._textures = dict(props.children("texture"))

    def report_textures(self, callback: TraversalCallback) -> None:
        """Report the textures as nested plugins, for `traverse`."""
        for name, texture in self.textures().items():
            callback.put(name, texture, ParamFlags.Differentiable)

    def textures(self) -> dict[str, Any]:
        """The textures by name."""
        return self.__dict__.get("_textures", {})

    def add_texture_attribute(self, name: str, texture: Any) -> None:
        """Give the shape a texture, in place of one of the same name.

        Raises:
            SceneError: it is no texture.
        """
        if getattr(texture, "kind", None) != "texture":
            raise SceneError(f"{self.id()}.{name}: a texture is expected, found {type(texture).__name__}")
        self._textures = {**self.textures(), name: texture}

    def texture_attribute(self, name: str) -> Any:
        """The texture of that name; raises `SceneError` if there is none."""
        if name not in self.textures():
            raise SceneError(f"{self.id()}: there is no texture '{name}'{near_miss(name, self.textures())}")
        return self.textures()[name]

    def remove_attribute(self, name: str) -> None:
        """Take the texture of that name from the shape; raises `SceneError` if there is none."""
        self.texture_attribute(name)
        self._textures = {key: texture for key, texture in self.textures().items() if key != name}

    # ---- questions ----------------------------------------------------------------------------

    def has_attribute(self, name: str, active: Bool | bool = True) -> bool:
        """Whether the shape has a texture, or values at its vertices or faces, of that name."""
        return name in self.textures() or name in getattr(self, "attributes", {})

    def eval_attribute(self, name: str, si: Any, active: Bool | bool = True) -> Color3f:
        """An attribute with one or three channels as a colour, at a point of the shape in a scene."""
        texture = self.textures().get(name)
        return Color3f(self._attribute(name, si, active)) if texture is None else texture.eval(si, active)

    def eval_attribute_1(self, name: str, si: Any, active: Bool | bool = True) -> Float:
        """An attribute with one channel, at a point of the shape in a scene; of a texture `eval_1`."""
        texture = self.textures().get(name)
        return Float(self._attribute(name, si, active)) if texture is None else texture.eval_1(si, active)

    def eval_attribute_3(self, name: str, si: Any, active: Bool | bool = True) -> Color3f:
        """The same as `eval_attribute`."""
        return self.eval_attribute(name, si, active)

    def eval_attribute_x(self, name: str, si: Any, active: Bool | bool = True) -> ArrayXf:
        """The channels of an attribute, at a point of the shape in a scene."""
        texture = self.textures().get(name)
        value: Any = self._attribute(name, si, active) if texture is None else texture.eval(si, active)
        return ArrayXf([value] if dr.depth_v(value) == 1 else list(value))

    def _attribute(self, name: str, si: Any, active: Bool | bool) -> Any:
        if not self.has_attribute(name):
            hint = near_miss(name, [*self.textures(), *getattr(self, "attributes", {})])
            raise SceneError(f"{self.id()}: there is no attribute '{name}'{hint}")
        return si.scene.geometry.attribute(name, si.face, si.prim_uv, active)
