"""Uses of textures by the plugins that hold them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from djpt.description.plugin import Plugin
from djpt.shapes.base import Shape
from djpt.textures.base import Texture

__all__ = ["check_textures", "reads_uv"]


def check_textures(shapes: Sequence[Shape]) -> None:
    """Raise `SceneError` if a texture of a BSDF can't be used on its shape."""
    for shape in shapes:
        bsdf = shape.bsdf()
        if bsdf is not None:
            for texture in textures_in(bsdf):
                texture.require_on(shape)


def textures_in(plugin: Plugin) -> Iterator[Texture]:
    """All textures in a plugin, itself included."""
    if isinstance(plugin, Texture):
        yield plugin
    for name in plugin.children:
        child = getattr(plugin, name)
        if isinstance(child, Plugin):
            yield from textures_in(child)


def reads_uv(plugin: Plugin) -> bool:
    """True if `plugin`, or anything in it, asks for more of a surface point than its place and frame."""
    if getattr(plugin, "needs_uv", False):
        return True
    if plugin.kind == "texture":
        return isinstance(plugin, Texture) and not plugin.is_constant
    children = [getattr(plugin, name) for name in plugin.children]
    return any(reads_uv(child) for child in children if isinstance(child, Plugin) and child.kind != "shape")
