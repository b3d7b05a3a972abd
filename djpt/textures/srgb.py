"""Constant colours under the name that Mitsuba's own scenes use."""

from __future__ import annotations

from djpt.core.numeric import as_vector
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_texture
from djpt.errors import SceneError
from djpt.textures.rgb import ConstantTexture

__all__ = ["SRGBReflectance", "three_numbers"]


class SRGBReflectance(ConstantTexture):
    """One linear sRGB colour in [0, 1].

    Parameters: `color` (three numbers, or a constant texture; required), `unbounded` (default false: numbers above 1
    are refused; true: any number, whoever uses the colour). In `traverse` the colour is `value`.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        color = three_numbers(props, "color")
        self._unbounded = props.boolean("unbounded", False)
        super().__init__(Properties(props.plugin_name(), props.node, {"value": color}, props.id()))
        if not self._unbounded:
            try:
                Allowed(0.0, 1.0).require(self._numbers(self.value))
            except SceneError as error:
                raise props.error("color", f"{error}, or 'unbounded' be true") from None

    def restrict(self, allowed: Allowed, where: str) -> None:
        if not self._unbounded:
            super().restrict(allowed, where)


def three_numbers(props: Properties, key: str) -> list[float]:
    """The red, green and blue of an entry, which may be a constant texture."""
    value = props[key]
    with props.naming(key):
        numbers: list[float] = as_vector(value).tolist()
    return numbers


register_texture("srgb", SRGBReflectance)
