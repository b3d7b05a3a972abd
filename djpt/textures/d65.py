"""The light of a lamp that is white in sRGB."""

from __future__ import annotations

from djpt.description.properties import Properties
from djpt.description.registry import register_texture
from djpt.errors import SceneError
from djpt.textures.base import Texture
from djpt.textures.srgb import SRGBReflectance, three_numbers
from djpt.textures.uniform import UniformTexture

__all__ = ["daylight"]


def daylight(props: Properties) -> Texture:
    """The spectrum D65 of daylight, by itself or as the light in which a colour or a texture is seen.

    D65 is the white of sRGB, so nothing is left of it in red, green and blue: the result is the number `scale`, the
    colour times `scale`, or the nested texture itself, whose numbers stay as they are (as in Mitsuba).

    Parameters: `scale` (default 1), `color` (three numbers), or a nested texture under any key.

    Raises:
        SceneError: There are a colour and a nested texture, or two textures.
    """
    scale = props.float("scale", 1.0)
    color = three_numbers(props, "color") if "color" in props else None
    nested = [(key, texture) for key, texture in props.children("texture") if key != "color"]
    if len(nested) > 1 or (nested and color is not None):
        found = ", ".join(f"'{key}'" for key, _ in nested) + (" and 'color'" if color is not None else "")
        raise SceneError(f"{props.node}: 'd65' takes one texture or a 'color', found {found}")
    if nested:
        texture: Texture = nested[0][1]
        return texture
    if color is None:
        return UniformTexture(Properties("uniform", props.node, {"value": scale}, props.id()))
    entries = {"color": [scale * x for x in color], "unbounded": True}
    return SRGBReflectance(Properties("srgb", props.node, entries, props.id()))


register_texture("d65", daylight)
