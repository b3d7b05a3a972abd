"""Constant numbers that aren't colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr

from djpt.core.numeric import as_array, describe
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_texture
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Bool, Color3f, Float
from djpt.textures.base import Texture

__all__ = ["RawConstant"]


class RawConstant(Texture):
    """One number or three, of any size: nothing is converted, and no user's range is asked for.

    Parameters: `value` (a number or three; required). Three numbers have no `eval_1`.
    """

    in_any_frame = True
    is_constant = True
    values: ClassVar[Mapping[str, ParamFlags]] = {"value": ParamFlags.Differentiable}
    statics: ClassVar[Sequence[str]] = ("channels",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        value = props.raw("value")
        with props.naming("value"):
            self.value = self._convert(value)
        self.channels = dr.size_v(self.value) if dr.depth_v(self.value) > 1 else 1
        """1 or 3: how many numbers there are."""

    @staticmethod
    def _convert(value: Any) -> Float | Color3f:
        """A number or three of width 1; Dr.Jit arrays stay attached to their gradients."""
        if dr.is_array_v(value) and dr.is_jit_v(value) and not dr.is_tensor_v(value) and dr.width(value) == 1:
            return Color3f(value) if dr.size_v(value) == 3 else Float(value)
        numbers = as_array(value)
        if numbers.shape not in ((), (3,)):
            raise SceneError(f"must be one or three numbers, found {describe(value)}")
        return Float(float(numbers)) if numbers.ndim == 0 else Color3f(*numbers.tolist())

    def check_parameter(self, name: str, value: Any) -> Any:
        converted = self._convert(value)
        if dr.depth_v(converted) != dr.depth_v(self.value):
            raise ParameterError(f"must be {'one number' if self.channels == 1 else 'three'}, found {describe(value)}")
        return converted

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        return Color3f(self.value)

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        if self.channels != 1:
            raise self.unknown("three numbers: eval_1() is not defined for 3D-valued textures")
        return Float(self.value)

    def mean(self) -> Float:
        value: Any = self.value
        return Float(value) if self.channels == 1 else (value.x + value.y + value.z) * (1 / 3)

    def max(self) -> float:
        return float(as_array(dr.detach(self.value)).max())

    def restrict(self, allowed: Allowed, where: str) -> None:
        """Allow everything."""


register_texture("rawconstant", RawConstant)
