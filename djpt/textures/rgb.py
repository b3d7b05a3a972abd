"""Constant colours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_array, describe
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_texture
from djpt.errors import SceneError
from djpt.jit.frozen import recording
from djpt.jit.types import Bool, Color3f, Float
from djpt.textures.base import Texture

__all__ = ["ConstantTexture"]


class ConstantTexture(Texture):
    """One linear sRGB colour; numbers and ``{'type': 'rgb'}`` in a description become this.

    Parameters: `value` (three numbers, or one for a grey; required). As a parameter it is always a
    `Color3f`, also for a grey (Mitsuba has a `Float` there); numbers can still be assigned.
    """

    in_any_frame = True
    is_constant = True
    values: ClassVar[Mapping[str, ParamFlags]] = {"value": ParamFlags.Differentiable}

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        value = props.raw("value")
        with props.naming("value"):
            self.value = self._convert(value)
        self._allowed = Allowed()

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        return self.value

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        """The mean of the three numbers, as in Mitsuba: bitmaps give the luminance."""
        return self.mean()

    def as_property(self) -> Color3f:
        return Color3f(self.value)

    def mean(self) -> Float:
        return (self.value.x + self.value.y + self.value.z) * (1 / 3)

    def max(self) -> float:
        return float(self._numbers(self.value).max())

    # ---- checks ------------------------------------------------------------------------

    @staticmethod
    def _convert(value: Any) -> Color3f:
        """A width-1 colour from any accepted form; Dr.Jit arrays stay attached to their gradients."""
        jit = dr.is_array_v(value) and dr.is_jit_v(value) and not dr.is_tensor_v(value)
        if jit and recording():
            return Color3f(value)
        numbers = as_array(dr.detach(value) if jit else value)
        if numbers.shape not in ((), (3,)):
            raise SceneError(f"must be one or three numbers, found {describe(value)}")
        if jit and dr.is_float_v(value):
            return Color3f(value)
        return Color3f(*(float(x) for x in np.broadcast_to(numbers, 3)))

    def restrict(self, allowed: Allowed, where: str) -> None:
        allowed.require(self._numbers(self.value), where)
        self._allowed = self._allowed.within(allowed)

    def check_parameter(self, name: str, value: Any) -> Any:
        return self._allowed.checked(self._convert(value))

    @staticmethod
    def _numbers(color: Color3f) -> NDArray[np.float64]:
        return as_array(dr.detach(color))


register_texture("rgb", ConstantTexture)
